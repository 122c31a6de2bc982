"""A benchmark of `trace`: rigs with known truths, recorded by a plant of its own.

`python -m benchmarks.trace --cases 120 --out DIR` records the cases, traces each, and
prints a table in Markdown. `DIR/results.jsonl` holds one line a case; a run that was
killed resumes there.
"""
