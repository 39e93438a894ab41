// A sampled PID controller of depth for rumoca, which evaluates no `when` and integrates by Euler's method in ten
// steps for each communication step. A sample is a pulse as long as one of these steps, with the derivative
// (new - old) / solver_step, which Euler's method turns into the new value.
model Pid
  parameter Real kp = 16.5 "N/m";
  parameter Real ki = 5.5 "N/(m.s)";
  parameter Real kd = 14.0 "N.s/m";
  parameter Real filter_time = 0.2 "s";
  parameter Real force_limit = 6.0 "N";
  parameter Real tracking_time = 1.0 "s";
  parameter Real period = 0.04 "s";
  parameter Real solver_step = 0.002 "s";
  input Real depth_reference "m";
  input Real measured_depth "m";
  output Real control_force "N";
protected
  constant Real pi = 3.141592653589793;
  Real clock(start = 0.0, fixed = true) "s";
  Real is_first(start = 1.0, fixed = true) "1 until the first sample, then 0";
  Real depth(start = 0.0, fixed = true);
  Real rate(start = 0.0, fixed = true);
  Real integral(start = 0.0, fixed = true);
  Real force(start = 0.0, fixed = true);
  Real pulse, a, error, new_rate, demand, new_force, grown, excess, new_integral;
equation
  // 1 in the step that begins at a multiple of the period, else 0; divided by the length of the step
  pulse = max(0.0, min(1.0, 1000.0 * (cos(2.0 * pi * clock / period) - cos(pi * solver_step / period)))) / solver_step;
  a = filter_time / (filter_time + period);
  error = depth_reference - measured_depth;
  new_rate = (1.0 - is_first) * (a * rate + (1.0 - a) * (measured_depth - depth) / period);
  demand = kp * error + integral - kd * new_rate;
  new_force = max(-force_limit, min(demand, force_limit));
  // anti-windup takes back what saturation has added, but never more than the integral holds
  grown = integral + period * ki * error;
  excess = period / tracking_time * (demand - new_force);
  new_integral = grown - max(min(grown, 0.0), min(excess, max(grown, 0.0)));
  der(clock) = 1.0;
  der(is_first) = -pulse * is_first;
  der(depth) = pulse * (measured_depth - depth);
  der(rate) = pulse * (new_rate - rate);
  der(integral) = pulse * (new_integral - integral);
  der(force) = pulse * (new_force - force);
  control_force = force;
end Pid;
