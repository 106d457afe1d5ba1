"""A mask and a target from different sources: how they belong together, and the fit under that.

``explanations`` tries what may have happened, a crop (``maps``), a resize of the mask
(``resized_masks``) or of the target (``resized_targets``), and otherwise the best map of the mask
onto the target (``map_fit``).
"""
