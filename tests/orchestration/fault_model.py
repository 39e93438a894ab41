"""What a faulty connection gives its receiver, sample by sample: written apart from what the master does."""

from bisect import bisect_right

from orchestration.system.faults import (
    Delay,
    Drift,
    DropOut,
    Fault,
    Freeze,
    InterpolatedDelay,
    Noise,
    Offset,
    Scale,
    Stuck,
)


def received(fault: Fault, times: list[float], sent: list[float]) -> list[float]:
    """What a receiver gets, one sample after the other, by the definition of each kind."""
    stream = fault.stream()
    got: list[float] = []
    begin: int | None = None
    for i, t in enumerate(times):
        if not fault.start <= t < fault.end:
            got.append(sent[i])
            continue
        begin = i if begin is None else begin
        match fault.effect:
            case Freeze():
                got.append(sent[begin])
            case Stuck(value):
                got.append(float(value))
            case Offset(value):
                got.append(sent[i] + value)
            case Drift(rate):
                got.append(sent[i] + rate * (t - times[begin]))
            case Noise(deviation):
                got.append(sent[i] + deviation * stream.standard_normal())
            case DropOut(probability):
                is_lost = stream.random() < probability and i > 0
                got.append((sent[i - 1] if i == begin else got[-1]) if is_lost else sent[i])
            case Delay(delay):
                nearest = min(range(i + 1), key=lambda j: abs(times[j] - (t - delay)))
                got.append(sent[nearest])
            case InterpolatedDelay(delay):
                before = max(bisect_right(times, t - delay) - 1, 0)
                after = min(before + 1, i)
                length = times[after] - times[before]
                part = max(t - delay - times[before], 0.0) / length if length else 0.0
                got.append(sent[before] + part * (sent[after] - sent[before]))
            case Scale(factor):
                got.append(factor * sent[i])
    return got
