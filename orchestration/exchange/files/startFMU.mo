within L1Depth;
impure function startFMU "Outputs at the start time, in initialisation mode"
  extends Modelica.Icons.Function;
  input FMU fmu;
  input Modelica.Units.SI.Time start;
  input Real u[:] "Inputs";
  input Integer ny "Number of outputs";
  output Real y[ny] "Outputs";
external "C" modelica_fmu_start(fmu, start, u, y)
  annotation (Include = "#include \"modelica_fmu.h\"",
    IncludeDirectory = "modelica://L1Depth/Resources/Include");
end startFMU;
