"""Rig files: read, checked, edited, and built into rigs and loops."""
