"""Messages of MCAP files and ROS bags as rows of numbers."""
