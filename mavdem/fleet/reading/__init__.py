"""Reading: logs in processes of their own, on this machine or on a cluster, each within its limits."""
