package Modelica
  package Icons
    partial function Function end Function;
    partial model Example end Example;
  end Icons;
  package Units package SI type Time = Real(unit="s"); end SI; end Units;
  package Utilities package Files
    function loadResource input String uri; output String fileReference; algorithm fileReference := uri; end loadResource;
  end Files; end Utilities;
  package Blocks
    package Icons partial block Block end Block; end Icons;
    package Interfaces
      connector RealInput = input Real;
      connector RealOutput = output Real;
    end Interfaces;
    package Types type Extrapolation = enumeration(HoldLastPoint, LastTwoPoints, Periodic, NoExtrapolation); end Types;
    package Sources
      block CombiTimeTable
        parameter Real table[:,:];
        parameter Types.Extrapolation extrapolation = Types.Extrapolation.LastTwoPoints;
        Interfaces.RealOutput y[1];
      equation
        y[1] = table[1,2] + time;
      end CombiTimeTable;
    end Sources;
  end Blocks;
end Modelica;
