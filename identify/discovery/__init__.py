"""What no known effect explains: curves at the places of a rig, then formulas."""
