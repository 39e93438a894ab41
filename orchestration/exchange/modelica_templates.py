"""Modelica text of the package that `modelica.py` fills in."""

PACKAGE = """\
package {package} {title}
  annotation (uses(Modelica(version = "4.0.0")));
end {package};
"""

FMU = """\
within {package};
class FMU "An instance of an FMI 2.0 co-simulation FMU"
  extends ExternalObject;

  function constructor "Instantiate and set the parameters"
    extends Modelica.Icons.Function;
    input String folder "Folder of the unpacked FMU";
    input String name "Its modelIdentifier";
    input String instanceName;
    input Integer realReferences[:];
    input Real reals[size(realReferences, 1)];
    input Integer integerReferences[:];
    input Integer integers[size(integerReferences, 1)];
    input Integer booleanReferences[:];
    input Integer booleans[size(booleanReferences, 1)] "0 or 1, as tools differ in arrays of Boolean";
    input Integer inputReferences[:];
    input Integer outputReferences[:];
    output FMU fmu;
  external "C" fmu = modelica_fmu_open(folder, name, instanceName,
      realReferences, reals, size(reals, 1),
      integerReferences, integers, size(integers, 1),
      booleanReferences, booleans, size(booleans, 1),
      inputReferences, size(inputReferences, 1), outputReferences, size(outputReferences, 1))
    annotation (Include = "#include \\"modelica_fmu.h\\"",
      IncludeDirectory = "modelica://{package}/Resources/Include");
  end constructor;

  function destructor "Terminate and free"
    extends Modelica.Icons.Function;
    input FMU fmu;
  external "C" modelica_fmu_close(fmu)
    annotation (Include = "#include \\"modelica_fmu.h\\"",
      IncludeDirectory = "modelica://{package}/Resources/Include");
  end destructor;
end FMU;
"""

START = """\
within {package};
impure function startFMU "Outputs at the start time, in initialisation mode"
  extends Modelica.Icons.Function;
  input FMU fmu;
  input Modelica.Units.SI.Time start;
  input Real u[:] "Inputs";
  input Integer ny "Number of outputs";
  output Real y[ny] "Outputs";
external "C" modelica_fmu_start(fmu, start, u, y)
  annotation (Include = "#include \\"modelica_fmu.h\\"",
    IncludeDirectory = "modelica://{package}/Resources/Include");
end startFMU;
"""

STEP = """\
within {package};
impure function stepFMU "Outputs after a communication step"
  extends Modelica.Icons.Function;
  input FMU fmu;
  input Modelica.Units.SI.Time start "Start of the simulation";
  input Modelica.Units.SI.Time h "Communication step size";
  input Integer k "Number of the step, from 1";
  input Real u[:] "Inputs, held over the step";
  input Integer ny "Number of outputs";
  output Real y[ny] "Outputs";
external "C" modelica_fmu_step(fmu, start, h, k, u, y)
  annotation (Include = "#include \\"modelica_fmu.h\\"",
    IncludeDirectory = "modelica://{package}/Resources/Include");
end stepFMU;
"""

BLOCK = """\
within {package};
block {name} {description}
  extends Modelica.Blocks.Icons.Block;
  parameter Modelica.Units.SI.Time communicationStep = {step} "Communication step size";
  parameter Modelica.Units.SI.Time startTime = 0 "Start of the simulation";
  parameter Boolean initialOutputsFollowInputs = false
    "At the start: outputs from the inputs, or from the inputs' start values, which breaks a loop"
    annotation (Evaluate = true);
  parameter String folder =
    Modelica.Utilities.Files.loadResource("modelica://{package}/Resources/FMUs/{name}")
    "Folder of the unpacked FMU";
{declarations}
protected
  FMU fmu = FMU(folder, "{name}", "{name}",
    {real_references}, {reals},
    {integer_references}, {integers},
    {boolean_references}, {booleans},
    {input_references}, {output_references});
  Real now[{n_inputs}] = {inputs} "Inputs at this time";
  discrete Real u[{n_inputs}] "Inputs at the last communication point";
  discrete Real y[{n_outputs}] "Outputs at the last communication point";
  discrete Integer k "Communication steps done";
initial equation
  k = 0;
  u = now;
  if initialOutputsFollowInputs then
    y = startFMU(fmu, startTime, now, {n_outputs});
  else
    y = startFMU(fmu, startTime, {starts}, {n_outputs});
  end if;
equation
  when sample(startTime + communicationStep, communicationStep) then
    k = pre(k) + 1;
    y = stepFMU(fmu, startTime, communicationStep, k, pre(u), {n_outputs});
    u = now;
  end when;
{outputs}
end {name};
"""

SYSTEM = """\
within {package};
model {system} {title}
  extends Modelica.Icons.Example;
{components}
equation
{equations}
  annotation (experiment(StartTime = {start}, StopTime = {stop}, Interval = {step}));
end {system};
"""
