"""Rigs and machines recorded by plants of their own, and what a trace makes of them.

The plants were written from the paper and the list of effects alone.
"""
