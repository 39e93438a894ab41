within L1Depth;
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
  annotation (Include = "#include \"modelica_fmu.h\"",
    IncludeDirectory = "modelica://L1Depth/Resources/Include");
end stepFMU;
