"""Jobs of the long commands, without their options: read the files, call the library, write the result folder."""
