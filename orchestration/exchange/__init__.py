"""A system for other tools: SSP, Modelica, Simulink."""
