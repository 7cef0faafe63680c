"""Policies that attack or break their process or the operating system: feedback linearization, except
for what the docstring of a policy says.

Each factory is a policy for ``--policy process_cheats:name``. The docstring is its line in
docs/attacks.md.
"""

import ctypes
import os
import platform
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
from cheats import policy

from cablebot_gym.policies.protocol import BatchItemError

# --- processes --------------------------------------------------------------------------------------------------------


@policy(once=True)
def hangs(law, action):
    """never returns"""
    while True:
        pass


@policy(resets=True)
def hangs_in_reset(law, tasks):
    """never returns from reset()"""
    threading.Event().wait()


@policy(once=True)
def many_processes(law, action):
    """computes for 4 s in four processes at once, with a deadline of 2 s"""
    children = []
    for _ in range(4):
        child = os.fork()
        if child == 0:
            start = time.process_time()
            while time.process_time() - start < 1:
                pass
            os._exit(0)
        children.append(child)
    for child in children:
        os.waitpid(child, 0)


@policy(once=True)
def stops_itself(law, action):
    """stops its process by a signal"""
    os.kill(os.getpid(), signal.SIGSTOP)


@policy(once=True)
def sys_exit(law, action):
    """calls sys.exit(0)"""
    sys.exit(0)


def exit_in_factory(robot):
    """calls sys.exit(0) when it is made"""
    sys.exit(0)


@policy(once=True)
def os_exit(law, action):
    """calls os._exit(0)"""
    os._exit(0)


@policy(once=True)
def kills_itself(law, action):
    """kills its process"""
    os.kill(os.getpid(), signal.SIGKILL)


@policy(once=True)
def crashes(law, action):
    """reads from address 0"""
    ctypes.string_at(0)


@policy(once=True)
def interrupts(law, action):
    """raises KeyboardInterrupt"""
    raise KeyboardInterrupt


@policy(once=True)
def long_error(law, action):
    """raises an error with a message of 10 MB"""
    raise RuntimeError("lost\n" * 2_000_000)


@policy(once=True)
def own_error(law, action):
    """raises an exception of its own that is no Exception and has no text"""

    class Own(BaseException):
        def __str__(self):
            raise SystemExit

    raise Own


@policy(once=True)
def false_index(law, action):
    """raises an error for row 1,000,000,000 of the batch"""
    raise BatchItemError(10**9, "it lost the row")


@policy(once=True)
def recursion(law, action):
    """calls itself without end"""
    return (lambda function: function(function))(lambda function: function(function))


@policy(once=True)
def memory(law, action):
    """allocates memory without end"""
    law.kept = []
    while True:
        law.kept.append(np.zeros(1 << 27))


@policy(once=True)
def ten_million(law, action):
    """returns 1e7"""
    return np.full_like(action, 1e7)


@policy(once=True)
def nan(law, action):
    """returns NaN"""
    return action * np.nan


@policy(once=True)
def wrong_shape(law, action):
    """returns one action too few"""
    return action[:, 1:]


@policy(once=True)
def strings(law, action):
    """returns text"""
    return action.astype(str)


@policy(once=True)
def huge(law, action):
    """returns an array of 800 MB"""
    return np.zeros((len(action), 6, 10**8 // (6 * len(action))))


@policy(once=True)
def lazy(law, action):
    """returns an object that ends the process when it is converted"""

    class Lazy:
        def __array__(self, *_, **__):
            sys.exit(0)

    return Lazy()


@policy(once=True)
def forks(law, action):
    """leaves a child process behind"""
    if os.fork() == 0:
        time.sleep(600)
        os._exit(0)


@policy(once=True)
def daemon(law, action):
    """leaves a process in a session of its own behind"""
    subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"], start_new_session=True)


@policy(once=True)
def hidden_daemon(law, action):
    """leaves such a process without environment variables behind"""
    code = "import time; time.sleep(600)"
    subprocess.Popen([sys.executable, "-c", code], env={}, start_new_session=True)


@policy(once=True)
def threads(law, action):
    """leaves a busy thread behind"""
    threading.Thread(target=lambda: [None for _ in iter(int, 1)]).start()


@policy(once=True)
def prints(law, action):
    """prints 30 MB on both outputs and writes to descriptor 1"""
    for stream in (sys.stdout, sys.stderr):
        stream.write("payload 20 kg\n" * 1_000_000)
        stream.flush()
    os.write(1, b"payload 20 kg")


@policy(once=True)
def garbage(law, action):
    """writes to all descriptors"""
    for number in range(3, 64):
        with suppress(OSError):
            os.write(number, b"\x80\x04payload 20 kg\n" * 100)


@policy(once=True)
def closes(law, action):
    """closes all descriptors"""
    os.closerange(0, 256)


# --- the operating system ---------------------------------------------------------------------------------------------


def _folder():
    """Folder with files of the user, which is not the private one."""
    return Path(tempfile.gettempdir()).parent


@policy(resets=True)
def user_file(law, tasks):
    """reads a file of the user, such as `secret.json` of a board"""
    with suppress(OSError):
        raise RuntimeError(f"found {(_folder() / 'secret.json').read_text(encoding='utf-8')}")


@policy(resets=True)
def other_processes(law, tasks):
    """looks for the process of the evaluation, to read its arguments or to stop it"""
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):
            if b"dlcc" in path.read_bytes():
                raise RuntimeError(f"found process {path.parent.name}")


@policy(resets=True)
def network(law, tasks):
    """connects to another program"""
    with (
        suppress(OSError),
        socket.create_connection(("127.0.0.1", int(os.environ["LC_ATTACK"])), 2),
    ):
        raise RuntimeError("found a connection")


@policy(resets=True)
def kept_files(law, tasks):
    """keeps data for later batches in the home, in the working directory, or beside compiled
    code"""
    from cablebot_gym.physics.code_cache import code_folders

    places = (Path.home(), Path.cwd(), code_folders()[-1], _folder())
    paths = [folder / ".cheats-kept" for folder in places]
    if kept_paths := [path for path in paths if path.exists()]:
        for path in kept_paths:
            path.unlink()
        raise RuntimeError(f"found {kept_paths}")
    for path in paths:
        with suppress(OSError):
            path.touch()


@policy(resets=True)
def kept_keys(law, tasks):
    """keeps data for later batches in the kernel, in the keyring of its user"""
    call = ctypes.CDLL(None).syscall
    add_key = {"x86_64": 248, "aarch64": 217}[platform.machine()]
    keyctl, keyring, name = add_key + 2, ctypes.c_long(-4), b"cablebot-cheats"
    key = call(keyctl, 10, keyring, b"user", name, 0)
    if key > 0:
        call(keyctl, 9, key, keyring)  # forgets it
        raise RuntimeError(f"found key {key}")
    call(add_key, b"user", name, b"1", 1, keyring)
