within L1Depth;
block L1DepthController "Extended L1 adaptive depth controller for an underwater vehicle"
  extends Modelica.Blocks.Icons.Block;
  parameter Modelica.Units.SI.Time communicationStep = 0.02 "Communication step size";
  parameter Modelica.Units.SI.Time startTime = 0 "Start of the simulation";
  parameter Boolean initialOutputsFollowInputs = false
    "At the start: outputs from the inputs, or from the inputs' start values, which breaks a loop"
    annotation (Evaluate = true);
  parameter String folder =
    Modelica.Utilities.Files.loadResource("modelica://L1Depth/Resources/FMUs/L1DepthController")
    "Folder of the unpacked FMU";
  parameter Real internal_step(unit = "s", min = 1e-06, max = 10.0) = 0.01 "Longest internal step";
  parameter Integer regressor(min = 1, max = 2) = 1 "Regressor that theta_hat multiplies: 1 infinity_norm, 2 state";
  parameter Integer filter_order(min = 1, max = 2) = 1 "Order of the low-pass filter C(s): 1 first, 3 third";
  parameter Integer augmentation(min = 1, max = 3) = 1 "Extension u_p of the control law: 1 none, 2 pi, 3 nonlinear_p";
  parameter Integer threshold(min = 1, max = 2) = 1 "Kind of the threshold of the nonlinear P: 1 fixed, 2 proportional_to_reference";
  parameter Real adaptation_gain(unit = "1", min = 0.0, max = 1000000000.0) = 100.0 "Adaptation gain Gamma (guess: the paper calls it very high and gives 1e4 for the example; docs/fidelity.md)";
  parameter Real projection_tolerance(unit = "1", min = 1e-06, max = 10.0) = 0.1 "Width eps of the boundary layer of the projection (guess)";
  parameter Real input_gain(unit = "1", min = 0.001, max = 1000.0) = 1.0 "Centre of the box of omega_hat, and its initial value (published: omega = 1)";
  parameter Real input_gain_uncertainty(unit = "1", min = 0.0, max = 1000.0) = 0.0 "Half-width of the box of omega_hat; 0 holds it (published: omega is known)";
  parameter Real filter_bandwidth(unit = "rad/s", min = 1e-06, max = 1000000.0) = 0.3073 "Bandwidth w of the low-pass filter C(s) (identified, docs/fidelity.md)";
  parameter Real nonlinear_exponent(unit = "1", min = 0.001, max = 1.0) = 0.1 "Exponent alpha of the nonlinear P (published, (9))";
  parameter Integer velocity_source(min = 1, max = 2) = 1 "Where the depth rate comes from: 1 alpha_beta_observer, 2 measured";
  parameter Real model_inertia(unit = "kg", min = 0.1, max = 1000000.0) = 5.5 "Inertia with added mass M_z that the design assumes (estimate: 3 kg and the added mass of a box)";
  parameter Real model_damping(unit = "N.s/m", min = 0.0, max = 1000000.0) = 2.5 "Linear damping D_z that the design assumes (guess: the paper gives none)";
  parameter Real depth_feedback_gain(unit = "N/m", min = 1e-06, max = 1000000.0) = 1.764 "k_m of the depth (identified, docs/fidelity.md)";
  parameter Real rate_feedback_gain(unit = "N.s/m", min = 0.0, max = 1000000.0) = 18.47 "k_m of the depth rate (identified, docs/fidelity.md)";
  parameter Real lyapunov_weight[2](each unit = "1", each min = 1e-09, each max = 1000000000.0) = {1.0, 1.0} "Diagonal of Q in the Lyapunov equation (guess)";
  parameter Real theta_bound[2](each unit = "N", each min = 0.0, each max = 1000000.0) = {5.0, 5.0} "Bound of |theta_hat| (guess that satisfies the L1-norm condition; per SI unit of the regressor)";
  parameter Real sigma_bound(unit = "N", min = 0.0, max = 1000000.0) = 10.0 "Bound of |sigma_hat| (guess)";
  parameter Real proportional_gain(unit = "N/m", min = 0.0, max = 1000000.0) = 3.709 "K_P of the PI (identified, docs/fidelity.md)";
  parameter Real integral_gain(unit = "N/(m.s)", min = 0.0, max = 1000000.0) = 0.004373 "K_I of the PI (identified, docs/fidelity.md)";
  parameter Real large_error_gain(unit = "1", min = 0.0, max = 1000000.0) = 1.0 "a_1 of the nonlinear P, in N per m^alpha (guess)";
  parameter Real small_error_gain(unit = "1", min = 0.0, max = 1000000.0) = 1.0 "a_2 of the nonlinear P, in N per m^alpha (guess)";
  parameter Real nonlinear_threshold(unit = "1", min = 0.0, max = 1000000.0) = 0.1 "delta in m, or its ratio to |r| (guess)";
  parameter Real threshold_floor(unit = "m", min = 1e-09, max = 1000000.0) = 0.01 "Least delta of the nonlinear P (guess)";
  parameter Real observer_alpha(unit = "1", min = 0.0, max = 1.0) = 0.4 "alpha of the observer (guess: not published)";
  parameter Real observer_beta(unit = "1", min = 0.0, max = 2.0) = 0.1 "beta of the observer (alpha^2 / (2 - alpha), Benedict and Bordner (1962); not published)";
  parameter Real observer_period(unit = "s", min = 0.0001, max = 10.0) = 0.04 "Sampling period of the observer (proxy: reading time of a Bar30 depth sensor)";
  parameter Real thruster_gain[2](each unit = "N/V", each min = 1e-06, each max = 1000000.0) = {0.25, 0.25} "Force coefficient K of each thruster (guess: the paper gives none)";
  parameter Real voltage_limit(unit = "V", min = 1e-06, max = 1000000.0) = 12.0 "Largest voltage of a thruster (guess: the paper gives none)";
  Modelica.Blocks.Interfaces.RealInput depth_reference(unit = "m") "Reference r of the depth";
  Modelica.Blocks.Interfaces.RealInput measured_depth(unit = "m") "Measured depth z, positive down";
  Modelica.Blocks.Interfaces.RealInput measured_depth_rate(unit = "m/s") "Depth rate z', used when velocity_source is measured";
  Modelica.Blocks.Interfaces.RealInput roll(unit = "rad") "Roll angle phi";
  Modelica.Blocks.Interfaces.RealInput pitch(unit = "rad") "Pitch angle theta";
  Modelica.Blocks.Interfaces.RealOutput voltage[2](each unit = "V") "Voltage of each thruster, saturated";
  Modelica.Blocks.Interfaces.RealOutput demanded_force(unit = "N") "u = u_m + u_a + u_p, earth frame, positive down";
  Modelica.Blocks.Interfaces.RealOutput u_m(unit = "N") "State feedback -k_m x";
  Modelica.Blocks.Interfaces.RealOutput u_a(unit = "N") "Adaptive control";
  Modelica.Blocks.Interfaces.RealOutput u_p(unit = "N") "Extension: PI or nonlinear P";
  Modelica.Blocks.Interfaces.RealOutput theta_hat[2](each unit = "N") "Estimate theta_hat, per SI unit of the regressor";
  Modelica.Blocks.Interfaces.RealOutput sigma_hat(unit = "N") "Estimate sigma_hat";
  Modelica.Blocks.Interfaces.RealOutput omega_hat(unit = "1") "Estimate omega_hat of the input gain";
  Modelica.Blocks.Interfaces.RealOutput predicted_depth(unit = "m") "Predicted state x_hat, depth";
  Modelica.Blocks.Interfaces.RealOutput predicted_depth_rate(unit = "m/s") "Predicted state x_hat, depth rate";
  Modelica.Blocks.Interfaces.RealOutput depth_prediction_error(unit = "m") "x_tilde = x_hat - x, depth";
  Modelica.Blocks.Interfaces.RealOutput depth_rate_prediction_error(unit = "m/s") "x_tilde = x_hat - x, depth rate";
  Modelica.Blocks.Interfaces.RealOutput tracking_error(unit = "m") "e = z - r";
  Modelica.Blocks.Interfaces.RealOutput estimated_depth_rate(unit = "m/s") "Depth rate that the law uses";
protected
  FMU fmu = FMU(folder, "L1DepthController", "L1DepthController",
    {0, 5, 6, 7, 8, 9, 10, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 30, 31, 32}, {internal_step, adaptation_gain, projection_tolerance, input_gain, input_gain_uncertainty, filter_bandwidth, nonlinear_exponent, model_inertia, model_damping, depth_feedback_gain, rate_feedback_gain, lyapunov_weight[1], lyapunov_weight[2], theta_bound[1], theta_bound[2], sigma_bound, proportional_gain, integral_gain, large_error_gain, small_error_gain, nonlinear_threshold, threshold_floor, observer_alpha, observer_beta, observer_period, thruster_gain[1], thruster_gain[2], voltage_limit},
    {1, 2, 3, 4, 11}, {regressor, filter_order, augmentation, threshold, velocity_source},
    fill(0, 0), fill(0, 0),
    {46, 47, 48, 49, 50}, {51, 52, 53, 54, 55, 56, 57, 58, 59, 60, 61, 62, 63, 64, 65, 66});
  Real now[5] = {depth_reference, measured_depth, measured_depth_rate, roll, pitch} "Inputs at this time";
  discrete Real u[5] "Inputs at the last communication point";
  discrete Real y[16] "Outputs at the last communication point";
  discrete Integer k "Communication steps done";
initial equation
  k = 0;
  u = now;
  if initialOutputsFollowInputs then
    y = startFMU(fmu, startTime, now, 16);
  else
    y = startFMU(fmu, startTime, {0.0, 0.0, 0.0, 0.0, 0.0}, 16);
  end if;
equation
  when sample(startTime + communicationStep, communicationStep) then
    k = pre(k) + 1;
    y = stepFMU(fmu, startTime, communicationStep, k, pre(u), 16);
    u = now;
  end when;
  voltage[1] = y[1];
  voltage[2] = y[2];
  demanded_force = y[3];
  u_m = y[4];
  u_a = y[5];
  u_p = y[6];
  theta_hat[1] = y[7];
  theta_hat[2] = y[8];
  sigma_hat = y[9];
  omega_hat = y[10];
  predicted_depth = y[11];
  predicted_depth_rate = y[12];
  depth_prediction_error = y[13];
  depth_rate_prediction_error = y[14];
  tracking_error = y[15];
  estimated_depth_rate = y[16];
end L1DepthController;
