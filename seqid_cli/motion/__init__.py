"""From a recording to joint motion: filtering, differentiation, accelerometers, segmentation."""
