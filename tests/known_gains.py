"""Parameters of ArduPilot's and PX4's roll controller, and the weights of an X's motors."""

from hover import px4_rotors

X_ROLL = (-1.0, 1.0, 1.0, -1.0)
ARDUPILOT = {
    "ATC_RAT_RLL_FLTT": 0.0,
    "ATC_RAT_RLL_FLTE": 0.0,
    "ATC_RAT_RLL_FLTD": 0.0,
    "ATC_RAT_RLL_P": 0.14,
    "ATC_RAT_RLL_I": 0.3,
    "ATC_RAT_RLL_D": 0.004,
    "ATC_ANG_RLL_P": 4.5,
    "FRAME_CLASS": 1.0,
    "MOT_THST_EXPO": 0.65,
    "MOT_SPIN_MIN": 0.15,
    "MOT_SPIN_MAX": 0.95,
    "INS_GYRO_FILTER": 0.0,
}
PX4 = {
    "MC_ROLLRATE_P": 0.15,
    "MC_ROLLRATE_I": 0.2,
    "MC_ROLLRATE_D": 0.003,
    "MC_ROLLRATE_K": 2.0,
    "MC_ROLL_P": 6.5,
    "CA_AIRFRAME": 0.0,
    "IMU_DGYRO_CUTOFF": 30.0,
    "THR_MDL_FAC": 0.3,
    **px4_rotors((0.1, 0.2, 0.05), (-0.1, -0.2, 0.05), (0.1, -0.2, -0.05), (-0.1, 0.2, -0.05)),
}
