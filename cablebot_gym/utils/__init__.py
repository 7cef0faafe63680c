"""Utilities: files, console output, code hashes, suggestions, colours and worker processes."""
