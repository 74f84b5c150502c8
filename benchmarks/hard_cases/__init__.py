"""The catalogue of hard cases: what is asked of each, and how it is measured. ``python benchmarks/hard_cases`` prints
it; ``tests/solve/test_hard_cases.py`` holds every case to what is asked."""
