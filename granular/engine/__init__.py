"""The engine: one compiled loop, specialised to the effects of a scene.

This page defines the terms used in the code. All numbers are in natural units
(`granular.schema.natural_units`): lengths in diameters D of the first species, times in tau.

A protocol is a sequence of stages, and the loop advances one stage at a time::

    stage    |==========================================================...
    frames   F                               F                          ...
    records  R               R               R               R          ...
    ticks    |-------|-------|-------|-------|-------|-------|-------|--...

One tick, here with twelve steps and a far field that acts every eight steps or fewer::

    steps    | 1 | 2 | 3 | 4 | 5 | 6 | 7 | 8 | 9 | 10| 11| 12| look
    far      <-----------------------><---------------------->

step
    The smallest advance: the kicks and drifts of a method in turn. Verlet's method is half a kick
    (of velocities at fixed positions), a drift (of positions at fixed velocities), the forces at the
    new positions, and the second half of the kick (`time_step`, `bodies`, `forces`).
tick
    Several steps followed by a *look* at the bed: the forces of the last step are computed in a
    *measuring pass*, which also sums energies, stiffness and the minimum distance. The result is a
    row of `columns`. Ticks of a stage have equal length (to within a step, if the user gives the
    time step); their number of steps may change (`tick_loop`).
record, frame
    At regular intervals of ticks the row is stored as a record and, less often, positions,
    velocities and forces of all grains as a frame.
schedule
    Division of a stage: lengths of tick and step, ticks per record and per frame. The automatic step
    resolves the stiffest mode that the bed can encounter; if a look finds a mode twice as stiff, the
    following ticks have more steps (`step_size`).
plan
    Data common to all steps of a run: the method's table of kicks and drifts, or its Butcher
    tableau, and the interval of the far field (`time_step`).
window
    Range of ticks for one call of the loop. A call takes about a tenth of a second and ends at the next
    frame. It returns its records to Python, which keeps the ledger, writes checkpoints and handles Ctrl-C
    (`run`).
stop criteria
    Conditions that end a call early: a grain at an impossible position, rest, a target force on the
    piston, a step that has become too long, a grain that has left.
far field
    If pairs are summed with a mesh, the slowly varying part of the force acts in impulses
    (`forces`): one kick opens an interval of at most ``far_every`` steps (``<``), one closes it
    (``>``), each with the present field over half the interval. Intervals divide a tick, so a look
    comes after whole intervals. The field at the start of the stage is *held*: it acts in every step
    like any other force, and the impulses give the difference from it. (In dissipative scenes the
    held field is updated at regular intervals of ticks.) Dry friction needs the whole force at once;
    with it, and with methods other than Verlet's, the far field is computed in every step, without
    impulses.

A run changes a `State` of plain arrays, and reads `Constants` (`granular.kernel_data`). The constants
contain a law for every effect that acts. The compiler inlines the kernels of these laws into the loop
(`granular.effects.effect`, `granular.compiled.hook_calls`); inactive effects cost nothing. A host (a
structure that carries the cell) moves all other bodies (`bodies`). `state` checks the energy of every record,
`granular.run.run_directory_writer` stores the data that a resumed run needs to continue bit by bit, and
`run_errors` makes the error messages. Kernels are declared with `granular.compiled`.
"""
