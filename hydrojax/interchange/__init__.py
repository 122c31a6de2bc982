"""Rigs for other tools: files for MATLAB, Modelica, an FMI master, and firmware."""

from __future__ import annotations

from .formats import FORMATS as FORMATS
from .formats import Export as Export
from .formats import export as export
