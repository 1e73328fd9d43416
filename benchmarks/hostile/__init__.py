"""Records and benches that are not as they should be: is a wrong number ever given without a warning?

python -m benchmarks.hostile
"""
