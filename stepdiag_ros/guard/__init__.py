"""What stands between the program and the outside: limits, files, YAML, JSON, text for terminals."""
