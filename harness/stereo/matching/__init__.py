"""Matchers: from a pair of panoramas to alpha_2. They return angles; the harness triangulates, the same for all."""
