"""Matchers: from a pair of views to alpha_2. They return angles; the harness triangulates, the same for all.

Nothing here depends on scenes or on the truth.
"""
