"""Tests of smajax.app."""
