"""Measured sets, predicted by hydrojax and by models that know no physics."""
