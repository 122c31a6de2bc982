"""Rigs for other tools: files for MATLAB, Modelica, an FMI master, and firmware."""

from __future__ import annotations

from hydrojax.export.formats import FORMATS as FORMATS
from hydrojax.export.formats import Export as Export
from hydrojax.export.formats import export as export
