"""The long commands from end to end, without their options: files in, a result folder out."""
