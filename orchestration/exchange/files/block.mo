within L1Depth;
block ${name} ${description}
  extends Modelica.Blocks.Icons.Block;
  parameter Modelica.Units.SI.Time communicationStep = ${step} "Communication step size";
  parameter Modelica.Units.SI.Time startTime = 0 "Start of the simulation";
  parameter Boolean initialOutputsFollowInputs = false
    "At the start: outputs from the inputs, or from the inputs' start values, which breaks a loop"
    annotation (Evaluate = true);
  parameter String folder =
    Modelica.Utilities.Files.loadResource("modelica://L1Depth/Resources/FMUs/${name}")
    "Folder of the unpacked FMU";
${declarations}
protected
  FMU fmu = FMU(folder, "${name}", "${name}",
    ${real_references}, ${reals},
    ${integer_references}, ${integers},
    ${boolean_references}, ${booleans},
    ${input_references}, ${output_references});
  Real now[${n_inputs}] = ${inputs} "Inputs at this time";
  discrete Real u[${n_inputs}] "Inputs at the last communication point";
  discrete Real y[${n_outputs}] "Outputs at the last communication point";
  discrete Integer k "Communication steps done";
initial equation
  k = 0;
  u = now;
  if initialOutputsFollowInputs then
    y = startFMU(fmu, startTime, now, ${n_outputs});
  else
    y = startFMU(fmu, startTime, ${starts}, ${n_outputs});
  end if;
equation
  when sample(startTime + communicationStep, communicationStep) then
    k = pre(k) + 1;
    y = stepFMU(fmu, startTime, communicationStep, k, pre(u), ${n_outputs});
    u = now;
  end when;
${outputs}
end ${name};
