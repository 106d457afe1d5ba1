"""Labels of the surfaces at the pixels of a scene."""

BACKGROUND_LABEL = 0
"""Label of a pixel that no surface covers."""
LIGHT_LABEL = 1
"""Label of a pixel whose nearest surface is the light's sphere."""
FIRST_OBJECT_LABEL = 2
"""Label of the first object of the mask; number i of these has this plus i."""
