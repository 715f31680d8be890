"""A study of section 6.6.5: what walls and corners of a scan say about the pose in a whole map, and how often it is so.

It is not part of the package: a scan says more than its features. `docs/evidence/features.md` has the results.
"""
