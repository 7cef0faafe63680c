"""Files, consoles, code hashes, suggestions and worker processes."""
