"""Joins source, recorder, detector and the referee's domain."""
