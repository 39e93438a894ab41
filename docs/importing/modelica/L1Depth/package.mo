package L1Depth "Nominal, extended L1 (PI)"
  annotation (uses(Modelica(version = "4.0.0")));
end L1Depth;
