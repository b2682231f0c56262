"""From a recording to joint motion: filters, derivatives, IMUs, segmentation."""
