"""Tests of the studies: small, the studies themselves are programs."""
