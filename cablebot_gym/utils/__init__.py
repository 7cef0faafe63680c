"""Utilities: files, console output, code hashes, checks of arguments, colours and worker
processes."""
