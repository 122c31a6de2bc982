"""Simulated cylinders and machines whose authors never saw hydrojax; traced blind."""
