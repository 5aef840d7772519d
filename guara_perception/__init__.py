"""Terrain perception for walking robots from one camera and a swept laser stripe."""
