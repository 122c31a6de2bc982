"""Machines that hydrojax was not shaped on: drawn, recorded and traced.

`laws` and `run` are a plant of their own: they import nothing of hydrojax. Only
`tracing` does.
"""
