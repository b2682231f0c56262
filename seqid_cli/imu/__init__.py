"""What one IMU tells of its link, and joint accelerations from all of them."""
