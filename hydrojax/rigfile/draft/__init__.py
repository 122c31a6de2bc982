"""A rig file drafted from a log and a few sizes of the cylinder."""
