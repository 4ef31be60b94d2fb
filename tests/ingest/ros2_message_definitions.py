"""Definitions of the messages of PX4 and MAVROS in ROS 2, as recordings have them."""

from __future__ import annotations

HEADER = """\
================================================================================
MSG: std_msgs/Header
# Standard metadata for higher-level stamped data types.

# Two-integer timestamp that is expressed as seconds and nanoseconds.
builtin_interfaces/Time stamp

# Transform frame with which this data is associated.
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
VECTOR = """\
================================================================================
MSG: geometry_msgs/Vector3
# This represents a vector in free space.
float64 x
float64 y
float64 z
"""
QUATERNION = """\
================================================================================
MSG: geometry_msgs/Quaternion
# This represents an orientation in free space in quaternion form.

float64 x 0
float64 y 0
float64 z 0
float64 w 1
"""
DEFINITIONS = {
    "px4_msgs/msg/VehicleAttitude": """\
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
""",
    "px4_msgs/msg/VehicleAngularVelocity": """\
uint64 timestamp         # time since system start (microseconds)
uint64 timestamp_sample  # timestamp of the data sample on which this message is based (microseconds)

float32[3] xyz           # Bias corrected angular velocity about the FRD body frame XYZ-axis in rad/s
float32[3] xyz_derivative # angular acceleration about the FRD body frame XYZ-axis in rad/s^2

# TOPICS vehicle_angular_velocity vehicle_angular_velocity_groundtruth
""",
    "px4_msgs/msg/ActuatorMotors": """\
# Motor control message

uint32 MESSAGE_VERSION = 0

uint64 timestamp\t\t\t# time since system start (microseconds)
uint64 timestamp_sample\t    # the timestamp the data this control response is based on was sampled

uint16 reversible_flags     # bitset which motors are configured to be reversible

uint8 ACTUATOR_FUNCTION_MOTOR1 = 101

uint8 NUM_CONTROLS = 12
float32[12] control # range: [-1, 1], where 1 means maximum positive thrust,
                    # -1 maximum negative (if not supported by the output, <0 maps to NaN),
                    # and NaN maps to disarmed (stop the motors)
""",
    "px4_msgs/msg/ActuatorOutputs": """\
uint64 timestamp\t\t\t\t# time since system start (microseconds)
uint8 NUM_ACTUATOR_OUTPUTS\t\t= 16
uint8 NUM_ACTUATOR_OUTPUT_GROUPS\t= 4\t# for sanity checking
uint32 noutputs\t\t\t\t# valid outputs
float32[16] output\t\t\t\t# output data, in natural output units

# actuator_outputs_sim is used for SITL, HITL & SIH (with an output range of [-1, 1])
# TOPICS actuator_outputs actuator_outputs_sim actuator_outputs_debug
""",
    "px4_msgs/msg/VehicleTorqueSetpoint": """\
uint64 timestamp        # time since system start (microseconds)
uint64 timestamp_sample # timestamp of the data sample on which this message is based (microseconds)

float32[3] xyz          # torque setpoint about X, Y, Z body axis (normalized)
""",
    "px4_msgs/msg/VehicleAttitudeSetpoint": """\
uint32 MESSAGE_VERSION = 1

uint64 timestamp # time since system start (microseconds)

float32 yaw_sp_move_rate # [rad/s] [@frame world NED] Rate for rotation around the vertical axis

# For quaternion-based attitude control
float32[4] q_d # [-] Desired quaternion for quaternion control

float32[3] thrust_body # [-] [@range -1, 1] Normalized thrust command in body FRD frame
""",
    "px4_msgs/msg/VehicleRatesSetpoint": """\
uint32 MESSAGE_VERSION = 0

uint64 timestamp # time since system start (microseconds)

# body angular rates in FRD frame
float32 roll # [rad/s] roll rate setpoint
float32 pitch # [rad/s] pitch rate setpoint
float32 yaw # [rad/s] yaw rate setpoint

float32[3] thrust_body # Normalized thrust command in body NED frame [-1,1]
bool reset_integral # Reset roll/pitch/yaw integrals (navigation logic change)
""",
    "px4_msgs/msg/BatteryStatus": """\
uint32 MESSAGE_VERSION = 1

uint64 timestamp # [us] Time since system start
bool connected # Whether or not a battery is connected
float32 voltage_v # [V] [@invalid 0] Battery voltage
float32 current_a # [A] [@invalid -1] Battery current
""",
    "px4_msgs/msg/VehicleImuStatus": """\
uint64 timestamp                # time since system start (microseconds)

uint32[3] accel_clipping        # total clipping per axis
uint32[3] gyro_clipping         # total clipping per axis

float32 accel_vibration_metric  # high frequency vibration level in the accelerometer data (m/s/s)
float32 gyro_vibration_metric   # high frequency vibration level in the gyro data (rad/s)
""",
    "px4_msgs/msg/SensorGps": """\
uint64 timestamp # time since system start (microseconds)

uint64 time_utc_usec # Timestamp (microseconds, UTC), this is the timestamp which comes from the gps module
uint8 satellites_used # Number of satellites used
""",
    "px4_msgs/msg/ManualControlSetpoint": """\
uint32 MESSAGE_VERSION = 0

uint64 timestamp # time since system start (microseconds)
uint64 timestamp_sample # the timestamp of the raw data (microseconds)

bool valid

uint8 SOURCE_UNKNOWN = 0
uint8 SOURCE_RC = 1 # radio control (input_rc)

uint8 data_source

float32 roll # move right, positive roll rotation, right side down
float32 pitch # move forward, negative pitch rotation, nose down
float32 yaw # positive yaw rotation, clockwise when seen top down
float32 throttle # move up, positive thrust, -1 is minimum available 0% or -100% +1 is 100% thrust
""",
    "px4_msgs/msg/VehicleThrustSetpoint": """\
uint64 timestamp        # time since system start (microseconds)
uint64 timestamp_sample # timestamp of the data sample on which this message is based (microseconds)

float32[3] xyz          # thrust setpoint along X, Y, Z body axis [-1, 1]
""",
    "px4_msgs/msg/VehicleStatus": """\
# Encodes the system state of the vehicle published by commander

uint32 MESSAGE_VERSION = 1

uint64 timestamp # time since system start (microseconds)

uint64 armed_time # Arming timestamp (microseconds)
uint64 takeoff_time # Takeoff timestamp (microseconds)

uint8 arming_state
uint8 ARMING_STATE_DISARMED = 1
uint8 ARMING_STATE_ARMED    = 2

uint8 latest_arming_reason
uint8 latest_disarming_reason
uint8 ARM_DISARM_REASON_STICK_GESTURE = 1
uint8 ARM_DISARM_REASON_RC_SWITCH = 2

uint64 nav_state_timestamp # time when current nav_state activated
uint8 nav_state_user_intention                  # Mode that the user selected
uint8 nav_state                                 # Currently active mode
uint8 NAVIGATION_STATE_POSCTL = 2               # Position control mode
uint8 NAVIGATION_STATE_OFFBOARD = 14
uint8 executor_in_charge                        # Current mode executor in charge (0=Autopilot)
uint32 valid_nav_states_mask                    # Bitmask for all valid nav_state values
uint32 can_set_nav_states_mask                  # Bitmask for all modes that a user can select

# Bitmask of detected failures
uint16 failure_detector_status
uint16 FAILURE_NONE = 0
uint16 FAILURE_ROLL = 1              # (1 << 0)

uint8 hil_state
uint8 HIL_STATE_OFF = 0

uint8 vehicle_type
uint8 VEHICLE_TYPE_UNSPECIFIED = 0
uint8 VEHICLE_TYPE_ROTARY_WING = 1
uint8 VEHICLE_TYPE_FIXED_WING = 2

bool failsafe # true if system is in failsafe state (e.g.:RTL, Hover, Terminate, ...)
bool failsafe_and_user_took_over # true if system is in failsafe state but the user took over control
uint8 failsafe_defer_state # one of FAILSAFE_DEFER_STATE_*

bool gcs_connection_lost              # datalink to GCS lost
uint8 gcs_connection_lost_counter     # counts unique GCS connection lost events
bool high_latency_data_link_lost

bool is_vtol             # True if the system is VTOL capable
bool is_vtol_tailsitter  # True if the system performs a 90\N{DEGREE SIGN} pitch down rotation during transition
bool in_transition_mode
bool in_transition_to_fw

# MAVLink identification
uint8 system_type  # system type, contains mavlink MAV_TYPE
uint8 system_id\t   # system id, contains MAVLink's system ID field
uint8 component_id # subsystem / component id, contains MAVLink's component ID field

bool pre_flight_checks_pass\t\t# true if all checks necessary to arm pass
""",
    "px4_msgs/msg/VehicleLandDetected": """\
uint64 timestamp # time since system start (microseconds)
bool freefall # true if vehicle is currently in free-fall
bool ground_contact # true if vehicle has ground contact but is not landed (1. stage)
bool maybe_landed # true if the vehicle might have landed (2. stage)
bool landed # true if vehicle is currently landed on the ground (3. stage)
bool in_ground_effect
bool in_descend
bool has_low_throttle
bool vertical_movement
bool horizontal_movement
bool rotational_movement
bool close_to_ground_or_skipped_check
bool at_rest
""",
    "px4_msgs/msg/VehicleControlMode": """\
uint64 timestamp\t\t# time since system start (microseconds)
bool flag_armed\t\t\t# synonym for actuator_armed.armed
bool flag_multicopter_position_control_enabled
bool flag_control_manual_enabled\t\t# true if manual input is mixed in
bool flag_control_auto_enabled\t\t\t# true if onboard autopilot should act
bool flag_control_offboard_enabled\t\t# true if offboard control should be used
""",
    "px4_msgs/msg/PositionSetpointTriplet": """\
# Global position setpoint triplet in WGS84 coordinates.
# This are the three next waypoints (or just the next two or one).

uint64 timestamp\t\t# time since system start (microseconds)

PositionSetpoint previous
PositionSetpoint current
PositionSetpoint next
================================================================================
MSG: px4_msgs/PositionSetpoint
# this file is only used in the position_setpoint triple as a dependency

uint64 timestamp\t\t# time since system start (microseconds)

uint8 SETPOINT_TYPE_POSITION=0\t# position setpoint
uint8 SETPOINT_TYPE_TAKEOFF=3\t# takeoff setpoint
uint8 SETPOINT_TYPE_LAND=4\t# land setpoint, altitude must be ignored, descend until landing

bool valid\t\t\t# true if setpoint is valid
uint8 type\t\t\t# setpoint type to adjust behavior of position controller
float32 vx\t\t\t# local velocity setpoint in m/s in NED
float64 lat\t\t\t# latitude, in deg
float32 yaw\t\t\t# yaw (only for multirotors), in rad [-PI..PI), NaN = hold current yaw
bool gliding_enabled
""",
    "px4_msgs/msg/VehicleLocalPosition": """\
# Fused local position in NED.
# The coordinate system origin is the vehicle position at the time when the EKF2-module was started.

uint32 MESSAGE_VERSION = 0

uint64 timestamp\t\t\t# time since system start (microseconds)
uint64 timestamp_sample                 # the timestamp of the raw data (microseconds)

bool xy_valid\t\t\t\t# true if x and y are valid
bool z_valid\t\t\t\t# true if z is valid
bool v_xy_valid\t\t\t\t# true if vx and vy are valid
bool v_z_valid\t\t\t\t# true if vz is valid

# Position in local NED frame
float32 x\t\t\t\t# North position in NED earth-fixed frame, (metres)
float32 y\t\t\t\t# East position in NED earth-fixed frame, (metres)
float32 z\t\t\t\t# Down position (negative altitude) in NED earth-fixed frame, (metres)

float32[2] delta_xy                     # Amount of lateral shift of position estimate in latest reset [m]
uint8 xy_reset_counter
float32 delta_z
uint8 z_reset_counter

# Velocity in NED frame
float32 vx \t\t\t\t# North velocity in NED earth-fixed frame, (metres/sec)
float32 vy\t\t\t\t# East velocity in NED earth-fixed frame, (metres/sec)
float32 vz\t\t\t\t# Down velocity in NED earth-fixed frame, (metres/sec)
float32 z_deriv\t\t\t\t# Down position time derivative in NED earth-fixed frame, (metres/sec)

uint64 ref_timestamp
float64 ref_lat\t\t\t\t# Reference point latitude, (degrees)
float32 dist_bottom\t\t\t# Distance from from bottom surface to ground, (metres)
# TOPICS vehicle_local_position vehicle_local_position_groundtruth external_ins_local_position
# TOPICS estimator_local_position
""",
    "sensor_msgs/msg/Imu": f"""\
# This is a message to hold data from an IMU (Inertial Measurement Unit)
#
# Accelerations should be in m/s^2 (not in g's), and rotational velocity should be in rad/sec

std_msgs/Header header

geometry_msgs/Quaternion orientation
float64[9] orientation_covariance # Row major about x, y, z axes

geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance # Row major about x, y, z axes

geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance # Row major x, y z
{HEADER}{QUATERNION}{VECTOR}""",
    "mavros_msgs/msg/RCOut": f"""\
# RAW Servo out state

std_msgs/Header header
uint16[] channels
{HEADER}""",
    "mavros_msgs/msg/RCIn": f"""\
# RAW RC input state

std_msgs/Header header
uint8 rssi
uint16[] channels
{HEADER}""",
    "mavros_msgs/msg/AttitudeTarget": f"""\
# Message for SET_ATTITUDE_TARGET

std_msgs/Header header

uint8 type_mask
uint8 IGNORE_ROLL_RATE = 1 # body_rate.x
uint8 IGNORE_ATTITUDE = 128 # orientation field

geometry_msgs/Quaternion orientation
geometry_msgs/Vector3 body_rate
float32 thrust
{HEADER}{QUATERNION}{VECTOR}""",
    "sensor_msgs/msg/BatteryState": f"""\
# Constants are chosen to match the enums in the linux kernel

std_msgs/Header  header
float32 voltage          # Voltage in Volts (Mandatory)
float32 temperature      # Temperature in Degrees Celsius (If unmeasured NaN)
{HEADER}""",
    "mavros_msgs/msg/State": f"""\
# Current autopilot state
#
# Known modes listed here:
# http://wiki.ros.org/mavros/CustomModes

std_msgs/Header header
bool connected
bool armed
bool guided
bool manual_input
string mode
uint8 system_status

string MODE_APM_COPTER_STABILIZE = STABILIZE
string MODE_PX4_OFFBOARD\t\t\t\t= OFFBOARD
{HEADER}""",
    "mavros_msgs/msg/ExtendedState": f"""\
# Extended autopilot state
uint8 VTOL_STATE_UNDEFINED = 0
uint8 LANDED_STATE_ON_GROUND = 1
uint8 LANDED_STATE_IN_AIR = 2

std_msgs/Header header
uint8 vtol_state
uint8 landed_state
{HEADER}""",
    "mavros_msgs/msg/ActuatorControl": f"""\
# raw servo values for direct actuator controls
std_msgs/Header header
uint8 group_mix
float32[8] controls

uint8 PX4_MIX_FLIGHT_CONTROL = 0
{HEADER}""",
    "geometry_msgs/msg/TwistStamped": f"""\
# A twist with reference coordinate frame and timestamp

std_msgs/Header header
Twist twist
{HEADER}================================================================================
MSG: geometry_msgs/Twist
# This expresses velocity in free space broken into its linear and angular parts.

Vector3  linear
Vector3  angular
{VECTOR}""",
    "sensor_msgs/msg/CompressedImage": f"""\
std_msgs/Header header
string format
uint8[] data
{HEADER}""",
}
"""The fields that these messages have, in their order, and some of their constants and comments; the longest are cut.

Sources: https://github.com/PX4/px4_msgs, https://github.com/mavlink/mavros/tree/ros2/mavros_msgs and
https://github.com/ros2/common_interfaces.
"""
