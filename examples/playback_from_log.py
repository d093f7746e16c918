"""Makes a page to look at from a saved log, without simulating again.

crar-drake run --out out/dance
python examples/playback_from_log.py out/dance/log.npz dance.html
"""

import sys

from crar_drake import SimulationLog
from crar_drake.results.playback import record_log

log_path, page = sys.argv[1], sys.argv[2]
log = SimulationLog.load(log_path)
record_log(log, page)
print(f"{page}: {log.time[-1]:.1f} s of {len(log.pair_names)} watched pairs")
