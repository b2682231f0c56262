"""MCAP files, and ROS bags by way of them."""
