/* A PID controller of depth: one step for each sampling period. */
#include "Pid.h"

#include <math.h>

void Pid_startup(PidState *self) {
    *self = (PidState){.kp = 16.5, .ki = 5.5, .kd = 14.0, .filter_time = 0.2,
                       .force_limit = 6.0, .tracking_time = 1.0, .period = 0.04};
    Pid_recalibrate(self);
}

void Pid_recalibrate(PidState *self) { self->a = self->filter_time / (self->filter_time + self->period); }

void Pid_dostep(PidState *self) {
    const double y = self->measured_depth, error = self->depth_reference - y;
    if (self->count++ > 0) self->rate = self->a * self->rate + (1 - self->a) * (y - self->depth) / self->period;
    const double demand = self->kp * error + self->integral - self->kd * self->rate;
    self->control_force = fmax(-self->force_limit, fmin(demand, self->force_limit));
    /* Anti-windup takes back what saturation has added, but never more than the integral holds. */
    const double integral = self->integral + self->period * self->ki * error;
    const double excess = self->period / self->tracking_time * (demand - self->control_force);
    self->integral = integral - fmin(fmax(excess, fmin(integral, 0)), fmax(integral, 0));
    self->depth = y;
}
