within L1Depth;
model DepthControl "Nominal, extended L1 (PI)"
  extends Modelica.Icons.Example;
  RovDepthPlant plant(
    communicationStep = 0.02,
    startTime = 0.0,
    internal_step = 0.02,
    thruster_efficiency = {1.0, 1.0},
    external_force = 0.0,
    buoyancy_change = 0.0,
    current_velocity = 0.0,
    roll = 0.0,
    pitch = 0.0);
  L1DepthController controller(
    communicationStep = 0.02,
    startTime = 0.0,
    initialOutputsFollowInputs = true,
    depth_feedback_gain = 1.764,
    rate_feedback_gain = 18.47,
    filter_bandwidth = 0.3073,
    proportional_gain = 3.709,
    integral_gain = 0.004373,
    internal_step = 0.02,
    augmentation = 2,
    roll = 0.0,
    pitch = 0.0);
  Modelica.Blocks.Sources.CombiTimeTable depth_reference(
    table = [0.0, 0.0; 40.0, 0.8; 140.0, 0.8; 180.0, 0.4; 250.0, 0.4; 310.0, 0.6],
    extrapolation = Modelica.Blocks.Types.Extrapolation.HoldLastPoint);
equation
  connect(plant.measured_depth, controller.measured_depth);
  connect(plant.depth_rate, controller.measured_depth_rate);
  connect(controller.voltage[1], plant.voltage[1]);
  connect(controller.voltage[2], plant.voltage[2]);
  connect(depth_reference.y[1], controller.depth_reference);
  annotation (experiment(StartTime = 0.0, StopTime = 310.0, Interval = 0.02));
end DepthControl;
