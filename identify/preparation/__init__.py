"""From logs to the windows that a fit replays."""
