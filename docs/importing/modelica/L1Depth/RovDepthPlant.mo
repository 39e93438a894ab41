within L1Depth;
block RovDepthPlant "Depth dynamics of a small underwater vehicle with two thrusters and a depth sensor"
  extends Modelica.Blocks.Icons.Block;
  parameter Modelica.Units.SI.Time communicationStep = 0.02 "Communication step size";
  parameter Modelica.Units.SI.Time startTime = 0 "Start of the simulation";
  parameter Boolean initialOutputsFollowInputs = false
    "At the start: outputs from the inputs, or from the inputs' start values, which breaks a loop"
    annotation (Evaluate = true);
  parameter String folder =
    Modelica.Utilities.Files.loadResource("modelica://L1Depth/Resources/FMUs/RovDepthPlant")
    "Folder of the unpacked FMU";
  parameter Real internal_step(unit = "s", min = 1e-06, max = 10.0) = 0.02 "Longest internal step";
  parameter Real initial_depth(unit = "m") = 0.0 "Depth at the start (published: the surface)";
  parameter Real initial_heave_velocity(unit = "m/s") = 0.0 "Heave velocity at the start (assumed: at rest)";
  parameter Real inertia(unit = "kg", min = 0.1, max = 1000000.0) = 5.5 "Inertia with added mass M_z (estimate: 3 kg (published) and the added mass of a box, DNV-RP-H103)";
  parameter Real linear_damping(unit = "N.s/m", min = 0.0, max = 1000000.0) = 2.5 "Linear damping D_z (guess: the paper gives none)";
  parameter Real quadratic_damping(unit = "N.s2/m2", min = 0.0, max = 1000000.0) = 7.0 "Quadratic damping D_q (estimate: 0.5 rho C_d A)";
  parameter Real weight(unit = "N", min = 0.001, max = 1000000000.0) = 29.43 "Weight W (published: 3 kg)";
  parameter Real net_weight(unit = "N", min = -1000000.0, max = 1000000.0) = -1.2 "W - B when submerged; negative floats (published: +0.2 N is 17 % of it, holding thrust 1.2 N)";
  parameter Boolean free_surface = true "Whether buoyancy falls as the vehicle emerges";
  parameter Real water_density(unit = "kg/m3", min = 1.0, max = 100000.0) = 1000.0 "Density of the water (fresh water, a pool)";
  parameter Real waterplane_area(unit = "m2", min = 1e-06, max = 10000.0) = 0.022192 "Horizontal section of the vehicle (published size: 0.152 m x 0.146 m)";
  parameter Boolean thruster_ideal = false "Switches dead zone, saturation and lag off";
  parameter Real thruster_gain[2](each unit = "N/V", each min = 1e-06, each max = 1000000.0) = {0.25, 0.25} "Force coefficient K of each thruster (guess: the paper gives none)";
  parameter Real thruster_dead_zone[2](each unit = "V", each min = 0.0, each max = 1000000.0) = {0.0, 0.0} "Voltage below which a thruster gives no force (guess: the paper gives none)";
  parameter Real thruster_voltage_limit[2](each unit = "V", each min = 1e-06, each max = 1000000.0) = {12.0, 12.0} "Largest voltage of each thruster (guess: the paper gives none)";
  parameter Real thruster_lag[2](each unit = "s", each min = 0.0, each max = 1000.0) = {0.05, 0.05} "Time constant of each thruster (guess: the paper gives none)";
  parameter Boolean sensor_ideal = false "Reports the true depth at every instant";
  parameter Real sensor_period(unit = "s", min = 0.0001, max = 10.0) = 0.04 "Sampling period (proxy: a Bar30 reads in up to 40 ms; not the paper's sensor)";
  parameter Real sensor_noise(unit = "m", min = 0.0, max = 1000.0) = 0.001 "Standard deviation of the white noise (guess: half the resolution)";
  parameter Real sensor_bias(unit = "m", min = -1000.0, max = 1000.0) = 0.0 "Bias (assumed)";
  parameter Real sensor_drift(unit = "m/s", min = -1000.0, max = 1000.0) = 0.0 "Drift, per second of simulation (assumed)";
  parameter Real sensor_resolution(unit = "m", min = 0.0, max = 1000.0) = 0.002 "Resolution; 0 does not quantise (proxy: a Bar30 resolves 2 mm; not the paper's sensor)";
  parameter Real sensor_delay(unit = "s", min = 0.0, max = 70.0) = 0.0 "Time from a sample to its report (assumed)";
  parameter Integer sensor_seed(min = 1, max = 2147483397) = 1 "Seed of the noise (chosen)";
  Modelica.Blocks.Interfaces.RealInput voltage[2](each unit = "V") "Voltage of each thruster";
  Modelica.Blocks.Interfaces.RealInput thruster_efficiency[2](each unit = "1") "1 healthy, 0 dead: a fault of each thruster";
  Modelica.Blocks.Interfaces.RealInput external_force(unit = "N") "Disturbance w_dz along the body's z axis, positive down";
  Modelica.Blocks.Interfaces.RealInput buoyancy_change(unit = "N") "Added to the buoyancy B, positive lifts";
  Modelica.Blocks.Interfaces.RealInput current_velocity(unit = "m/s") "Vertical current in the earth frame, positive down";
  Modelica.Blocks.Interfaces.RealInput roll(unit = "rad") "Roll angle phi";
  Modelica.Blocks.Interfaces.RealInput pitch(unit = "rad") "Pitch angle theta";
  Modelica.Blocks.Interfaces.RealOutput depth(unit = "m") "True depth z, positive down";
  Modelica.Blocks.Interfaces.RealOutput depth_rate(unit = "m/s") "True depth rate z' = J w";
  Modelica.Blocks.Interfaces.RealOutput heave_velocity(unit = "m/s") "Heave velocity w in the body frame";
  Modelica.Blocks.Interfaces.RealOutput measured_depth(unit = "m") "Depth as the sensor reports it";
  Modelica.Blocks.Interfaces.RealOutput thruster_force[2](each unit = "N") "Force of each thruster along the body's z axis, positive down";
  Modelica.Blocks.Interfaces.RealOutput total_force(unit = "N") "tau_z, sum of the thruster forces";
protected
  FMU fmu = FMU(folder, "RovDepthPlant", "RovDepthPlant",
    {0, 1, 2, 3, 4, 5, 6, 7, 9, 10, 12, 13, 14, 15, 16, 17, 18, 19, 21, 22, 23, 24, 25, 26}, {internal_step, initial_depth, initial_heave_velocity, inertia, linear_damping, quadratic_damping, weight, net_weight, water_density, waterplane_area, thruster_gain[1], thruster_gain[2], thruster_dead_zone[1], thruster_dead_zone[2], thruster_voltage_limit[1], thruster_voltage_limit[2], thruster_lag[1], thruster_lag[2], sensor_period, sensor_noise, sensor_bias, sensor_drift, sensor_resolution, sensor_delay},
    {27}, {sensor_seed},
    {8, 11, 20}, {if free_surface then 1 else 0, if thruster_ideal then 1 else 0, if sensor_ideal then 1 else 0},
    {28, 29, 30, 31, 32, 33, 34, 35, 36}, {37, 38, 39, 40, 41, 42, 43});
  Real now[9] = {voltage[1], voltage[2], thruster_efficiency[1], thruster_efficiency[2], external_force, buoyancy_change, current_velocity, roll, pitch} "Inputs at this time";
  discrete Real u[9] "Inputs at the last communication point";
  discrete Real y[7] "Outputs at the last communication point";
  discrete Integer k "Communication steps done";
initial equation
  k = 0;
  u = now;
  if initialOutputsFollowInputs then
    y = startFMU(fmu, startTime, now, 7);
  else
    y = startFMU(fmu, startTime, {0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0}, 7);
  end if;
equation
  when sample(startTime + communicationStep, communicationStep) then
    k = pre(k) + 1;
    y = stepFMU(fmu, startTime, communicationStep, k, pre(u), 7);
    u = now;
  end when;
  depth = y[1];
  depth_rate = y[2];
  heave_velocity = y[3];
  measured_depth = y[4];
  thruster_force[1] = y[5];
  thruster_force[2] = y[6];
  total_force = y[7];
end RovDepthPlant;
