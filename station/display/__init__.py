"""Showing what happens: each display only reads events, and may fail without harming what is measured."""
