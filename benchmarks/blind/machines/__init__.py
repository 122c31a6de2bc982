"""Cranes, excavators and presses: a differential cylinder at a proportional valve."""
