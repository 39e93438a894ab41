package L1Depth ${title}
  annotation (uses(Modelica(version = "4.0.0")));
end L1Depth;
