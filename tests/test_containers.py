"""Containers: grouping by a key."""

from mavdem.containers import group_by


def test_items_with_one_key_are_one_group_in_their_order():
    assert group_by(["bc", "a", "de", "f"], len) == {2: ["bc", "de"], 1: ["a", "f"]}
