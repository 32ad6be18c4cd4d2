"""Logs in and out: rosbag2 and MCAP files, without ROS."""
