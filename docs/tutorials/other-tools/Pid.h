/* Inputs, output and parameters, then the state. */
typedef struct {
    double depth_reference, measured_depth, control_force;
    double kp, ki, kd, filter_time, force_limit, tracking_time, period;
    double a, depth, rate, integral, count;
} PidState;

void Pid_startup(PidState *self);
void Pid_recalibrate(PidState *self);
void Pid_dostep(PidState *self);
