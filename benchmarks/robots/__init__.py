"""Robots of packages on PyPI, imported without hand work: do they dance?"""
