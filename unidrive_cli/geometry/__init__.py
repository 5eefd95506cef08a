"""Pure float64 numpy: poses, lenses, the half-ball scene surface, blending weights, boxes.

Conventions (docs/conventions.md): ego x forward, y left, z up; camera x right, y down, z along the
optical axis; `a_from_b` takes points of frame b to frame a; integer pixel coordinates are pixel centres.
"""
