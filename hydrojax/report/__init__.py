"""What all reports share: pages, text, style, files."""
