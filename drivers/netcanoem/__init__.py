"""ATI 9105-NETCANOEM: strain gauges over CAN, calibrated by the matrix that the board holds."""
