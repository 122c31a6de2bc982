"""Controllers, and the loop they close: the paper's law, inputs, simulation, theory."""
