"""Records shown: the report, its parts, and still pictures."""
