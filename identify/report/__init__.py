"""A result as report.json, figures and one self-contained page."""
