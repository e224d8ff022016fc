"""The jobs behind the long commands, without their options: files in, a result folder out."""
