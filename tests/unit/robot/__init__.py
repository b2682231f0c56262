"""Tests of the robot package."""
