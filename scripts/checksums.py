#!/usr/bin/env python3
"""Whether two versions of the program give the same bits: CRC-32 of the final state and of the design gradient of 117 short runs.

    python3 scripts/checksums.py target/release/hydrograd now.csv               # writes the table, in about 5 minutes
    python3 scripts/checksums.py target/release/hydrograd now.csv before.csv    # and compares: exit code 1 and the names where a bit differs

Cases: scene x method x precision x threads x instruction set (HYDROGRAD_SIMD), drives, objectives, parametrisations, a kernel, an
integrator, composed operators, three dimensions. Keys are those of version 3e73266, which later versions still read, so that the
same script compares with a program of that time. Make both tables on one machine. Needs numpy and h5py."""

import csv, json, os, subprocess, sys, tempfile, zlib
import h5py
binary, table = os.path.abspath(sys.argv[1]), sys.argv[2]
old = {r['case']: r for r in csv.DictReader(open(sys.argv[3]))} if len(sys.argv) > 3 else {}
CHANNEL = ['time.end=0.2', 'objective.window=0.05', 'design.shape=sine', 'design.amplitude=0.01']
SHORT = {'taylor-green': .02, 'taylor-green-3d': .1, 'poiseuille': .0001, 'couette': .005, 'reverse-poiseuille': .05, 'reverse-poiseuille-3d': .05, 'lid-driven-cavity': .05,
         'lid-driven-cavity-3d': .05, 'slab': .01, 'isothermal-channel': .05, 'dam-break': .05, 'dam-break-3d': .05, 'falling-block': .05, 'hydrostatic-tank': .05}
cases = []
for method, keys in {'consistent': [], 'standard': ['fluid.formulation=standard'], 'fixed': ['fluid.motion=fixed'], 'chain-off': ['fluid.shift=isotropic']}.items():
    for precision in ('f64', 'f32'):
        for simd in ('', 'avx2', 'portable'):
            for threads in (1, 2):
                cases.append(('heated-channel %s %s %s %d' % (method, precision, simd or 'best', threads), 'heated-channel', CHANNEL + keys + ['run.precision=' + precision], simd, threads, True))
    for scene, end in SHORT.items():
        for precision in ('f64', 'f32'):
            if method in ('consistent', 'standard'):
                cases.append(('%s %s %s' % (scene, method, precision), scene, ['time.end=%g' % end] + keys + ['run.precision=' + precision], 'avx2', 2, False))
for drive in ('flow-rate', 'pumping-power'):
    for motion in ('moving', 'fixed'): cases.append(('heated-channel %s %s' % (drive, motion), 'heated-channel', CHANNEL + ['fluid.drive=' + drive] + (['fluid.motion=fixed'] if motion == 'fixed' else []), 'avx2', 2, True))
for kind in ('outlet-temperature', 'wall-heat'): cases.append(('heated-channel ' + kind, 'heated-channel', CHANNEL + ['objective.kind=' + kind], 'avx2', 2, True))
for more in ('design.walls=both', 'design.parametrisation=b-spline', 'resolution.kernel=wendland-c2', 'time.integrator=symplectic-euler', 'run.kernels=composed'):
    cases.append(('heated-channel ' + more, 'heated-channel', CHANNEL + [more], 'avx2', 2, True))
cases.append(('heated-channel-3d', 'heated-channel-3d', ['time.end=0.1', 'objective.window=0.05'], 'avx2', 2, True))
cases.append(('custom', 'custom', ['time.end=0.2'], 'avx2', 2, False))

def run(command, scene, keys, simd, threads, out):
    line = [binary, command, scene, '--threads', str(threads), '--out', out]
    for key in keys: line += ['--set', key]
    if command == 'check-gradient': line += ['--directions', '1']
    environment = dict(os.environ, **({'HYDROGRAD_SIMD': simd} if simd else {}))
    return subprocess.run(line, capture_output=True, text=True, env=environment, timeout=300)

rows, wrong = [], []
for name, scene, keys, simd, threads, gradient in cases:
    with tempfile.TemporaryDirectory() as folder:
        r = run('simulate', scene, keys + ['output.frames=0'], simd, threads, folder + '/s')
        row = {'case': name, 'state': 'refused', 'gradient': '', 'q': ''}
        if r.returncode == 0:
            crc = 0
            with h5py.File(folder + '/s/state.h5') as f:
                names = []; f.visititems(lambda n, o: names.append(n) if isinstance(o, h5py.Dataset) else None)
                for n in sorted(names):
                    value = f[n][()]; crc = zlib.crc32(value.tobytes() if hasattr(value, 'tobytes') else repr(value).encode(), zlib.crc32(n.encode(), crc))
            row['state'] = '%08x' % crc
            if gradient:
                run('check-gradient', scene, keys, simd, threads, folder + '/g')
                try: g = json.load(open(folder + '/g/gradient_check.json')); row['gradient'] = '%08x' % zlib.crc32(repr(g['gradient']).encode()); row['q'] = repr(g.get('objective', g.get('q', g.get('v', g.get('t', g.get('w'))))))
                except Exception as e: row['gradient'] = 'none'
        rows.append(row)
        if old and any(row[k] != old.get(name, {}).get(k) for k in ('state', 'gradient', 'q')): wrong.append(name); print('differs: %s\n   now %s\n   was %s' % (name, row, old.get(name)), flush=True)
with open(table, 'w', newline='') as f:
    w = csv.DictWriter(f, ['case', 'state', 'gradient', 'q']); w.writeheader(); w.writerows(rows)
print('%d cases, %d refused%s' % (len(rows), sum(r['state'] == 'refused' for r in rows), ', %d differ' % len(wrong) if old else '')); sys.exit(bool(wrong))
