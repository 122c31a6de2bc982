"""Peers of the simulator: the same model in other tools, to be timed beside it.

Each peer is one Python call; README.md says what it is and how it was held to the
simulator. `tests/test_speed_peers.py` does the holding.
"""
