"""ROS 2 recordings of PX4 and MAVROS topics."""
