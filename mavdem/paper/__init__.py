"""The experiments of the paper, run again: ``mavdem reproduce``.

Needs the extra ``paper``: ``pip install 'mavdem[paper]'``.
"""
