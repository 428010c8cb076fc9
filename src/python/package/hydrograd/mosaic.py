"""The former name of :mod:`hydrograd.tesseract`."""

from .tesseract import *  # noqa: F403
