within L1Depth;
model System ${title}
  extends Modelica.Icons.Example;
${components}
equation
${equations}
  annotation (experiment(StartTime = ${start}, StopTime = ${stop}, Interval = ${step}));
end System;
