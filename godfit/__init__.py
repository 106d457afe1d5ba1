"""Reads the parameters of god rays out of images."""
