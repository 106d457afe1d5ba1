"""The live page: one file that runs the user's shader in the browser on the fitted numbers."""
