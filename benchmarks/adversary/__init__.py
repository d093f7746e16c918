"""A search for a counterexample to "every control step leaves a clear braking path".

`python -m benchmarks.adversary` runs it; `docs/measurements/adversary.md` says what is
attacked.
"""
