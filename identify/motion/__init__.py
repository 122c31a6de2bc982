"""Motion as an output: a log's drive moves a load, whose position is predicted."""
