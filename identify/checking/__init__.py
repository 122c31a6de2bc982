"""Whether rig file and logs can be true, before anything is fitted."""
