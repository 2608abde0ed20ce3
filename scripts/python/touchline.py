"""Attaches to a Touchline group. Needs `pip install iceoryx2==0.10.0`, and Python 3.10 or newer."""

import contextlib
import ctypes
import importlib.metadata
import mmap
import os
import struct
import time

import iceoryx2 as iox2
from touchline_messages import TOPICS


def directory_of(instance):
    """Where a group keeps its files (see ARCHITECTURE.md, "Instances, files and rights")."""
    base = os.environ.get("TOUCHLINE_RUNTIME_DIR")
    if not base:
        runtime = os.environ.get("XDG_RUNTIME_DIR")
        base = os.path.join(runtime, "touchline") if runtime else f"/tmp/touchline-{os.getuid()}"
    return os.path.join(base, instance)


def memory_of(directory):
    """The group's names in shared memory, as (root path, prefix, version of iceoryx2); None while it
    does not exist."""
    try:
        with open(os.path.join(directory, "memory"), encoding="utf-8") as note:
            values = dict(line.rstrip("\n").split("=", 1) for line in note)
        root, prefix, version = values["root_path"], values["prefix"], values["iceoryx2"]
    except (FileNotFoundError, ValueError, KeyError):
        return None
    return (root, prefix, version) if os.path.isdir(root) else None


# Every program may publish on these; on all others only messages of the group's own processes are
# accepted.
OPEN_TOPICS = {"commands"}


class Roster:
    """The nodes of the group's own processes: a count and 511 keys of 64 bits (common/client/src/roster.rs)."""

    def __init__(self, root):
        with open(os.path.join(root, "roster.page"), "rb") as file:
            self.page = mmap.mmap(file.fileno(), 4096, access=mmap.ACCESS_READ)
        self.believed = None

    def has(self, node):
        """Whether a node, given by its number, belongs to the group."""
        if node == self.believed:
            return True
        seconds, nanoseconds, pid, counter = (node >> shift & 0xFFFFFFFF for shift in (0, 32, 64, 96))
        turned = [(part << by | part >> 32 - by) & 0xFFFFFFFF for part, by in ((seconds, 30), (counter, 16))]
        digest = ((turned[0] ^ nanoseconds ^ turned[1]) + pid) & 0xFFFFFFFF
        if pid << 32 | digest not in struct.unpack("512Q", self.page[:])[1:]:
            return False
        self.believed = node
        return True


class Group:
    """A running group. Topics are opened by name: `world`, `commands`, `frames`, …"""

    def __init__(self, instance="default", name="python", patience_s=10.0):
        directory = directory_of(instance)
        ends = time.monotonic() + patience_s
        while not (memory := memory_of(directory)):
            if time.monotonic() > ends:
                raise TimeoutError(f"no group {instance!r} is running ({directory})")
            time.sleep(0.1)
        root, prefix, version = memory
        own = importlib.metadata.version("iceoryx2")
        if own != version:
            raise RuntimeError(
                f"the group {instance!r} uses iceoryx2 {version}, and this program {own}, which do not "
                f"understand each other: pip install iceoryx2=={version}"
            )
        iox2.set_log_level(iox2.LogLevel.Fatal)
        config = iox2.config.default()
        config.global_cfg.root_path = iox2.Path.new(root)
        config.global_cfg.prefix = iox2.FileName.new(prefix)
        # The supervisor cleans up after dead processes.
        config.global_cfg.node.cleanup_dead_nodes_on_creation = False
        config.global_cfg.node.cleanup_dead_nodes_on_destruction = False
        config.global_cfg.service.cleanup_dead_nodes_on_open = False
        self.node = (
            iox2.NodeBuilder.new()
            .name(iox2.NodeName.new(name))
            .config(config)
            .signal_handling_mode(iox2.SignalHandlingMode.Disabled)
            .create(iox2.ServiceType.Ipc)
        )
        self.patience_s = patience_s
        self.roster = Roster(root)

    def _open(self, name):
        topic = TOPICS[name]
        ends = time.monotonic() + self.patience_s
        while True:
            service = self.node.service_builder(iox2.ServiceName.new(name))
            service = service.publish_subscribe(iox2.Slice[topic.element])
            if topic.header:
                service = service.user_header(topic.header)
            try:
                return service.open()
            except iox2.PublishSubscribeOpenError:
                # A group that is just starting.
                if time.monotonic() > ends:
                    raise
                time.sleep(0.1)

    def reader(self, name):
        """Reads a topic: messages of the group, and on `commands` of every program."""
        roster = None if name in OPEN_TOPICS else self.roster
        port = self._open(name).subscriber_builder().create()
        listener = self._listener(name) if TOPICS[name].notifies else None
        return Reader(port, TOPICS[name].header is not None, roster, listener)

    def _listener(self, name):
        """Wakes a reader of a topic whose writers also notify an event of the same name."""
        service = self.node.service_builder(iox2.ServiceName.new(name)).event().open()
        return service.listener_builder().create()

    def writer(self, name):
        """Publishes on a topic whose messages have one element."""
        builder = self._open(name).publisher_builder().initial_max_slice_len(1)
        builder = builder.allocation_strategy(iox2.AllocationStrategy.Static)
        builder = builder.backpressure_strategy(iox2.BackpressureStrategy.DiscardData)
        return Writer(builder.create(), TOPICS[name].element)


class Reader:
    """Reads messages in place: they are valid until the next one is requested.

    It sleeps until a writer notifies it; on topics without an event it looks each millisecond.
    """

    #: A writer may end between a message and its notification.
    LONGEST_SLEEP_S = 0.05

    def __init__(self, port, has_header=False, roster=None, listener=None):
        self.port = port
        self.listener = listener
        self.has_header = has_header
        self.roster = roster
        self.sample = None

    def next(self, timeout_s=1.0):
        """The next message as (elements, header), or None if none arrives in time."""
        ends = time.monotonic() + timeout_s
        while True:
            self.sample = self.port.receive()
            if self.sample is not None and self._is_believed():
                header = self.sample.user_header().contents if self.has_header else None
                return self.sample.payload(), header
            left_s = ends - time.monotonic()
            if left_s < 0:
                return None
            if self.sample is None:
                self._sleep(min(left_s, self.LONGEST_SLEEP_S))

    def _sleep(self, longest_s):
        if self.listener is None:
            time.sleep(0.001)
        else:
            self.listener.timed_wait(iox2.Duration.from_micros(max(1, int(longest_s * 1e6))))

    def _is_believed(self):
        return self.roster is None or self.roster.has(self.sample.header.node_id.value)

    def messages(self, timeout_s=1.0):
        """The messages of a topic with one element each, until none arrives in time."""
        while (message := self.next(timeout_s)) is not None:
            yield message[0][0]


class Writer:
    """Publishes messages."""

    def __init__(self, port, element):
        self.port = port
        self.element = element

    def send(self, message):
        """Publishes a copy of a message."""
        sample = self.port.loan_slice_uninit(1)
        ctypes.memmove(sample.payload_ptr, ctypes.byref(message), ctypes.sizeof(message))
        sample.assume_init().send()


def monotonic_ns():
    """The clock of all stamps."""
    return time.clock_gettime_ns(time.CLOCK_MONOTONIC)


@contextlib.contextmanager
def until_interrupted():
    """Ctrl-C is the usual end."""
    try:
        yield
    except KeyboardInterrupt:
        pass
