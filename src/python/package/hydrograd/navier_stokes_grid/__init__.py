"""Navier-Stokes from a velocity field to a velocity field as a Tesseract: ``tesseract_api.py`` here, see the page on Python."""
