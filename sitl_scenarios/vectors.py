"""Vectors and attitude quaternions as tuples of floats, with the few operations that the simulation needs.

The physics take hundreds of steps per simulated second with vectors of three and four elements. Plain floats are about
ten times as fast there as NumPy arrays. Quaternions are (w, x, y, z), of unit length, from body axes (forward, right,
down) to north-east-down (NED).
"""

from math import asin, atan2, sqrt

Vector3 = tuple[float, ...]
"""Three floats: a vector in NED or in body axes, or values about roll, pitch and yaw."""

Vector4 = tuple[float, ...]
"""Four floats: a value for each rotor in the autopilots' order, or demands of roll, pitch, yaw and thrust."""

Quaternion = tuple[float, float, float, float]
"""A quaternion (w, x, y, z)."""


def dot(a: Vector3, b: Vector3) -> float:
    """Returns the inner product of two vectors."""
    ax, ay, az = a
    bx, by, bz = b
    return ax * bx + ay * by + az * bz


def advanced(value: Vector3, rate: Vector3, seconds: float) -> Vector3:
    """Returns a vector after so many ``seconds`` at a constant ``rate`` of change per second (an Euler step)."""
    x, y, z = value
    rate_x, rate_y, rate_z = rate
    return x + seconds * rate_x, y + seconds * rate_y, z + seconds * rate_z


def rotation_matrix(attitude: Quaternion) -> tuple[Vector3, Vector3, Vector3]:
    """Returns the rotation matrix of a unit quaternion, from body axes to north-east-down.

    Args:
        attitude: Unit quaternion (w, x, y, z).

    Returns:
        The three rows of the matrix.
    """
    w, x, y, z = attitude
    x2 = x + x
    y2 = y + y
    z2 = z + z
    xx = x * x2
    yy = y * y2
    zz = z * z2
    xy = x * y2
    xz = x * z2
    yz = y * z2
    wx = w * x2
    wy = w * y2
    wz = w * z2
    return (
        (1.0 - yy - zz, xy - wz, xz + wy),
        (xy + wz, 1.0 - xx - zz, yz - wx),
        (xz - wy, yz + wx, 1.0 - xx - yy),
    )


def rotated(attitude: Quaternion, half_angles: Vector3) -> Quaternion:
    """Rotates an attitude by small angles about its body axes.

    The attitude is multiplied by the quaternion (1, half angles), the rotation to first order. The result is slightly
    longer than a unit quaternion: normalise it with ``normalised`` before it is used as an attitude.

    Args:
        attitude: Quaternion (w, x, y, z) before the rotation.
        half_angles: Half of the rotation angles about the forward, right and down axes (3,), rad.

    Returns:
        Quaternion (w, x, y, z), not normalised.
    """
    (w, x, y, z) = attitude
    (roll, pitch, yaw) = half_angles
    return (
        w - x * roll - y * pitch - z * yaw,
        x + w * roll + y * yaw - z * pitch,
        y + w * pitch + z * roll - x * yaw,
        z + w * yaw + x * pitch - y * roll,
    )


def normalised(quaternion: Quaternion) -> Quaternion:
    """Returns a quaternion scaled to unit length."""
    w, x, y, z = quaternion
    squared_length = w * w + x * x + y * y + z * z
    scale = 1.0 / sqrt(squared_length)
    return w * scale, x * scale, y * scale, z * scale


def euler_angles(attitude: Quaternion) -> tuple[float, float, float]:
    """Converts an attitude to Euler angles, in the aerospace sequence Z-Y-X (yaw first).

    Args:
        attitude: Unit quaternion (w, x, y, z).

    Returns:
        Roll, pitch and yaw, rad.
    """
    w, x, y, z = attitude
    roll = atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    sine_of_pitch = 2 * (w * y - z * x)
    # Rounding may carry the sine beyond ±1 when the nose points straight up or down.
    pitch = asin(min(max(sine_of_pitch, -1.0), 1.0))
    yaw = atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return roll, pitch, yaw
