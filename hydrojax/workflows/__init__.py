"""What needs both identification and tuning: friction bounds, fleets of logs."""
