"""A module with the documented names of uldaq over the simulated bench, to stand in for it."""

from contextlib import ExitStack
from enum import IntEnum
from types import SimpleNamespace

from bench_far import ArmFar

from hil.drivers.premium import PremiumArm, PremiumConfig
from hil.drivers.usb_31xx import driver as usb_31xx
from hil.drivers.usb_quad08 import driver as usb_quad08
from hil.rig.boxes import BoxPlace, BoxWire
from hil.signals.bus import Bus


def numbers(name, **values):
    return IntEnum(name, values)


class FakeUldaq:
    """One USB-QUAD08 and one USB-3101; values of the enumerations are those of uldaq 1.2.3."""

    InterfaceType = numbers("InterfaceType", USB=1, BLUETOOTH=2, ETHERNET=4, ANY=7)
    ScanStatus = numbers("ScanStatus", IDLE=0, RUNNING=1)
    ScanOption = numbers("ScanOption", DEFAULTIO=0, CONTINUOUS=8)
    CounterMeasurementType = numbers("CounterMeasurementType", COUNT=1, ENCODER=16)
    CounterMeasurementMode = numbers(
        "CounterMeasurementMode",
        ENCODER_X1=0,
        ENCODER_X2=1 << 19,
        ENCODER_X4=1 << 20,
        ENCODER_LATCH_ON_Z=1 << 21,
        ENCODER_CLEAR_ON_Z=1 << 22,
    )
    CounterEdgeDetection = numbers("CounterEdgeDetection", RISING_EDGE=1, FALLING_EDGE=2)
    CounterTickSize = numbers("CounterTickSize", TICK_20ns=11)
    CounterDebounceMode = numbers("CounterDebounceMode", NONE=0)
    CounterDebounceTime = numbers("CounterDebounceTime", DEBOUNCE_0ns=0)
    CConfigScanFlag = numbers("CConfigScanFlag", DEFAULT=0)
    CInScanFlag = numbers("CInScanFlag", DEFAULT=0, CTR16_BIT=1, CTR32_BIT=2, CTR64_BIT=4)
    Range = numbers("Range", BIP10VOLTS=5)
    AOutFlag = numbers("AOutFlag", DEFAULT=0)
    AOutListFlag = numbers("AOutListFlag", DEFAULT=0, SIMULTANEOUS=4)
    DigitalDirection = numbers("DigitalDirection", INPUT=1, OUTPUT=2)

    class ULException(Exception):  # noqa: N818
        """What every function raises."""

    def __init__(self, far):
        self.far, self.plugged, self.muted, self.jump = far, True, False, 0
        self.calls, self.beats, self.config, self.scan = [], 0, {}, None
        self.connected = 0
        far.bench.after.append(self.tick)

    def reach(self):
        if not self.plugged:
            raise self.ULException("ERR_DEAD_DEV: Dead device")

    def get_daq_device_inventory(self, kind):
        names = ("USB-QUAD08", "USB-3101") if self.plugged else ()
        return [SimpleNamespace(product_name=n, unique_id=f"01{k}") for k, n in enumerate(names)]

    def create_int_buffer(self, channels, samples):
        return [0] * (channels * samples)

    def DaqDevice(self, descriptor):
        return SimpleNamespace(
            connect=self.connect,
            disconnect=self.disconnect,
            release=lambda: None,
            get_ctr_device=lambda: self,
            get_ao_device=lambda: self,
            get_dio_device=lambda: self,
        )

    def connect(self):
        self.reach()
        self.connected += 1

    def disconnect(self):
        self.reach()
        self.connected -= 1

    # counters

    def c_config_scan(self, counter, *how):
        self.reach()
        assert len(how) == 7
        self.config[counter] = how

    def c_in_scan(self, low, high, samples, rate, options, flags, data):
        self.reach()
        bits = {self.CInScanFlag.CTR16_BIT: 16, self.CInScanFlag.CTR32_BIT: 32}[flags]
        zero = self.far.wire.counts.tolist()
        self.scan = SimpleNamespace(
            low=low, high=high, samples=samples, rate=rate, data=data, bits=bits, zero=zero, done=0
        )
        return rate

    def scan_stop(self):
        self.scan = None
        self.reach()

    def get_scan_status(self):
        self.reach()
        status = self.ScanStatus.RUNNING if self.scan else self.ScanStatus.IDLE
        done = self.scan.done if self.scan else 0
        return status, SimpleNamespace(current_scan_count=done)

    def tick(self, now_ns):
        s = self.scan
        if s is None or self.muted or not self.plugged:
            return
        width, now = s.high - s.low + 1, self.far.wire.counts.tolist()
        for _ in range(round(s.rate * 1e-3)):
            at = s.done % s.samples * width
            for k in range(width):
                s.data[at + k] = (now[k + s.low] - s.zero[k + s.low] + self.jump) % (1 << s.bits)
            s.done += 1
        self.jump = 0

    # outputs

    def volts(self, channel, value):
        self.far.bench.codes[0][channel] = round(value * 3276.8)

    def a_out(self, channel, analog_range, flags, data):
        self.reach()
        assert analog_range == self.Range.BIP10VOLTS
        self.calls.append("a_out")
        self.volts(channel, data)

    def a_out_list(self, low, high, ranges, flags, data):
        self.reach()
        assert len(ranges) == len(data) == high - low + 1
        self.calls.append("a_out_list")
        for channel, value in zip(range(low, high + 1), data, strict=True):
            self.volts(channel, value)

    def get_info(self):
        return SimpleNamespace(get_port_types=lambda: [10])

    def d_config_bit(self, port, bit, direction):
        self.reach()
        assert (port, direction) == (10, self.DigitalDirection.OUTPUT)

    def d_bit_out(self, port, bit, data):
        self.reach()
        self.beats += 1


class UldaqFar(ArmFar):
    """An arm behind both boxes, reached through the library."""

    def __init__(self, quad=None, dac=None):
        super().__init__()
        self.library = FakeUldaq(self)
        self.quad = usb_quad08.Config(route="uldaq", **(quad or {}))
        self.dac = usb_31xx.Config(route="uldaq", **(dac or {}))
        self.steps = {}
        self.bench.after.append(lambda now_ns: [step() for step in list(self.steps.values())])

    @property
    def now_ns(self):
        return self.bench.now_ns

    def run(self, name, step):
        self.steps[name] = step
        return lambda: self.steps.pop(name, None) and None

    def bus(self, kind):
        pause = lambda s: self.bench.advance(self.now_ns + max(1, round(s * 1e3)) * 1_000_000)  # noqa: E731
        return Bus(kind, None, self.run, pause, lambda: self.now_ns, self.bench.advance)

    def unplug(self):
        self.library.plugged = False

    def replug(self):
        self.library.plugged, self.library.connected = True, 0
        self.bench.codes[:] = 0

    def mute(self, on):
        self.library.muted = on

    def garble(self):
        self.library.jump = 1 << 14

    def open(self):
        with ExitStack() as stack:
            quad = usb_quad08.open_box("quad", self.bus("usb"), "", self.quad, (0, 1, 2))
            stack.callback(quad.close)
            dac = usb_31xx.open_box("dac", self.bus("hid"), "", self.dac, (0, 1, 2))
            stack.callback(dac.close)
            rows = {
                "encoders": [(quad, BoxPlace("quad", k, 1)) for k in range(3)],
                "motors": [(dac, BoxPlace("dac", k, 1)) for k in range(3)],
            }
            wire = BoxWire("arm", rows, self.bench.advance)
            wire.close = stack.pop_all().close
        return PremiumArm("arm", wire, PremiumConfig(home=tuple(self.pose)), 1e-3)
