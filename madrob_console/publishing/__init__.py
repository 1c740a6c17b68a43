"""A competition's pages: a static site that is written again after each result."""

from __future__ import annotations
