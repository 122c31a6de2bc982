"""What a fit or a trace found, as plain data and in words."""
