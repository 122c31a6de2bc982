"""Force-controlled hydraulic cylinders, their faults and the logs they leave."""
