"""Logs: from files of any accepted kind to SI arrays on common sample times."""
