"""The plan that tells two effects apart."""
