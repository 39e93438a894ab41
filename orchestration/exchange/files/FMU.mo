within L1Depth;
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
    annotation (Include = "#include \"modelica_fmu.h\"",
      IncludeDirectory = "modelica://L1Depth/Resources/Include");
  end constructor;

  function destructor "Terminate and free"
    extends Modelica.Icons.Function;
    input FMU fmu;
  external "C" modelica_fmu_close(fmu)
    annotation (Include = "#include \"modelica_fmu.h\"",
      IncludeDirectory = "modelica://L1Depth/Resources/Include");
  end destructor;
end FMU;
