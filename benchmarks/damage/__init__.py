"""Damaged logs and rig files, by the thousand."""
