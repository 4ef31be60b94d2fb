"""Definitions of the messages of PX4 and MAVROS in ROS 2, as recordings have them, but for most comments."""

HEADER = """\
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
VECTOR = """\
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"""
QUATERNION = """\
================================================================================
MSG: geometry_msgs/Quaternion
float64 x 0
float64 y 0
float64 z 0
float64 w 1
"""
ATTITUDE = """\
# This is similar to the mavlink message ATTITUDE_QUATERNION, but for onboard use
# The quaternion uses the Hamilton convention, and the order is q(w, x, y, z)

uint32 MESSAGE_VERSION = 0

uint64 timestamp                # time since system start (microseconds)

uint64 timestamp_sample         # the timestamp of the raw data (microseconds)

float32[4] q                    # Quaternion rotation from the FRD body frame to the NED earth frame
float32[4] delta_q_reset        # Amount by which quaternion has changed during last reset
uint8 quat_reset_counter        # Quaternion reset counter

# TOPICS vehicle_attitude vehicle_attitude_groundtruth external_ins_attitude
# TOPICS estimator_attitude
"""

_PLAIN = {
    "px4_msgs/msg/VehicleAngularVelocity": "uint64 timestamp; uint64 timestamp_sample; float32[3] xyz",
    "px4_msgs/msg/ActuatorMotors": (
        "uint64 timestamp; uint64 timestamp_sample; uint16 reversible_flags; float32[12] control"
    ),
    "px4_msgs/msg/ActuatorOutputs": "uint64 timestamp; uint32 noutputs; float32[16] output",
    "px4_msgs/msg/VehicleTorqueSetpoint": "uint64 timestamp; uint64 timestamp_sample; float32[3] xyz",
    "px4_msgs/msg/VehicleAttitudeSetpoint": "uint64 timestamp; float32 yaw_sp_move_rate; float32[4] q_d",
    "px4_msgs/msg/VehicleRatesSetpoint": (
        "uint64 timestamp; float32 roll; float32 pitch; float32 yaw; bool reset_integral"
    ),
    "px4_msgs/msg/BatteryStatus": "uint64 timestamp; bool connected; float32 voltage_v; float32 current_a",
    "px4_msgs/msg/VehicleImuStatus": "uint64 timestamp; uint32[3] accel_clipping; float32 accel_vibration_metric",
    "px4_msgs/msg/SensorGps": "uint64 timestamp; uint64 time_utc_usec; uint8 satellites_used",
    "px4_msgs/msg/ManualControlSetpoint": (
        "uint64 timestamp; bool valid; float32 roll; float32 pitch; float32 yaw; float32 throttle"
    ),
    "px4_msgs/msg/VehicleThrustSetpoint": "uint64 timestamp; uint64 timestamp_sample; float32[3] xyz",
    "px4_msgs/msg/VehicleStatus": (
        "uint32 MESSAGE_VERSION = 1; uint64 timestamp; uint64 armed_time; uint8 arming_state; uint8 "
        "ARMING_STATE_ARMED = 2; uint8 nav_state; uint8 vehicle_type; uint8 VEHICLE_TYPE_FIXED_WING = 2; bool "
        "failsafe; uint8 system_type; uint8 system_id; uint8 component_id; bool pre_flight_checks_pass"
    ),
    "px4_msgs/msg/VehicleLandDetected": "uint64 timestamp; bool freefall; bool landed; bool at_rest",
    "px4_msgs/msg/VehicleControlMode": "uint64 timestamp; bool flag_armed; bool flag_control_auto_enabled",
    "px4_msgs/msg/PositionSetpointTriplet": (
        "uint64 timestamp; PositionSetpoint previous; PositionSetpoint current; PositionSetpoint next; "
        "================================================================================; MSG: "
        "px4_msgs/PositionSetpoint; uint64 timestamp; uint8 SETPOINT_TYPE_LAND=4; bool valid; uint8 type; float32 "
        "vx; float64 lat"
    ),
    "px4_msgs/msg/VehicleLocalPosition": (
        "uint32 MESSAGE_VERSION = 0; uint64 timestamp; uint64 timestamp_sample; bool xy_valid; bool z_valid; bool "
        "v_xy_valid; bool v_z_valid; float32 x; float32 y; float32 z; float32 vx; float32 vy; float32 vz; float32 "
        "z_deriv"
    ),
    "sensor_msgs/msg/Imu": (
        "std_msgs/Header header; geometry_msgs/Quaternion orientation; float64[9] orientation_covariance; "
        "geometry_msgs/Vector3 angular_velocity; float64[9] angular_velocity_covariance; geometry_msgs/Vector3 "
        "linear_acceleration; float64[9] linear_acceleration_covariance; @HEADER; @QUATERNION; @VECTOR"
    ),
    "mavros_msgs/msg/RCOut": "std_msgs/Header header; uint16[] channels; @HEADER",
    "mavros_msgs/msg/RCIn": "std_msgs/Header header; uint8 rssi; uint16[] channels; @HEADER",
    "mavros_msgs/msg/AttitudeTarget": (
        "std_msgs/Header header; uint8 type_mask; uint8 IGNORE_ROLL_RATE = 1; uint8 IGNORE_ATTITUDE = 128; "
        "geometry_msgs/Quaternion orientation; geometry_msgs/Vector3 body_rate; float32 thrust; @HEADER; "
        "@QUATERNION; @VECTOR"
    ),
    "sensor_msgs/msg/BatteryState": "std_msgs/Header header; float32 voltage; float32 temperature; @HEADER",
    "mavros_msgs/msg/State": (
        "std_msgs/Header header; bool connected; bool armed; bool guided; bool manual_input; string mode; uint8 "
        "system_status; string MODE_APM_COPTER_STABILIZE = STABILIZE; string MODE_PX4_OFFBOARD = OFFBOARD; @HEADER"
    ),
    "mavros_msgs/msg/ExtendedState": (
        "uint8 LANDED_STATE_IN_AIR = 2; std_msgs/Header header; uint8 vtol_state; uint8 landed_state; @HEADER"
    ),
    "mavros_msgs/msg/ActuatorControl": "std_msgs/Header header; uint8 group_mix; float32[8] controls; @HEADER",
    "geometry_msgs/msg/TwistStamped": (
        "std_msgs/Header header; Twist twist; @HEADER; "
        "================================================================================; MSG: geometry_msgs/Twist; "
        "Vector3 linear; Vector3 angular; @VECTOR"
    ),
}
"""Fields, constants and, behind lines of "=", the messages within; "@" names one of the above."""


def _written(plain: str) -> str:
    return "".join(globals()[line[1:]] if line[0] == "@" else f"{line}\n" for line in plain.split("; "))


DEFINITIONS = {"px4_msgs/msg/VehicleAttitude": ATTITUDE} | {name: _written(plain) for name, plain in _PLAIN.items()}
