"""Plant and controller in C, period after period: how long each takes."""
