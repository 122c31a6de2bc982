"""Compiled programs: made once for each structure, kept on disk, let go of again."""
