"""PX4's ULog files."""
