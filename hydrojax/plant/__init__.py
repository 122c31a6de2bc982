"""The plant: valve, chambers, friction, load, and the one step that moves them."""
