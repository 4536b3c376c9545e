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
    The smallest advance in time: the kicks and drifts of a method in turn. A kick changes velocities at
    fixed positions, a drift changes positions at fixed velocities. Verlet's method is half a kick, a
    drift, and half a kick with the forces at the new positions (`time_step`, `bodies`, `forces`).
tick
    Several steps followed by a *look* at the bed: the forces of the last step are computed in a
    *measuring pass*, which also sums energies, stiffness and the minimum distance. The result is a
    row of `columns`. Ticks of a stage have equal length (to within a step, if the user gives the
    time step); their number of steps may change (`tick_loop`).
record, frame
    Every few ticks the row is stored as a record. At longer intervals, positions, velocities and forces
    of all grains are stored as a frame.
energy turned over
    Maximum so far of kinetic energy + changes of potential energy + losses + work. Errors of the energy
    balance are given relative to it (`state`).
schedule
    Division of a stage: lengths of tick and step, ticks per record and per frame. The automatic step
    resolves the highest frequency that the bed can reach; if a look finds twice this frequency, the
    following ticks have more steps (`step_size`).
plan
    Data common to all steps of a run: the method's table of kicks and drifts, or its Butcher
    tableau, and the interval of the far field (`time_step`).
window
    Range of ticks for one call of the loop. A call takes about a tenth of a second and ends at the next
    frame. It returns its records to Python, which checks the energy balance, writes checkpoints and handles
    Ctrl-C (`run`).
stop criteria
    Conditions that end a call early: a grain is at an impossible position or has left the cell, the bed
    is at rest, the piston force has reached its target, or the step has become too long.
far field
    If pairs are summed with a mesh, the slowly varying part of the force acts in impulses
    (`forces`). At the beginning (``<``) and at the end (``>``) of each interval of ``far_every`` or fewer
    steps, the present field kicks the grains for half the interval. A tick consists of whole intervals.
    The field at the start of the stage is *held*: it acts in every step like any other force, and the
    impulses give the difference between the present and the held field. In dissipative scenes the held
    field is updated at regular intervals of ticks. With dry friction, which depends on the whole force, and
    with methods other than Verlet's, the far field is computed in every step, without impulses.

A run changes a `State` of plain arrays, and reads `Constants` (`granular.kernel_data`). The constants
contain a law for every effect that acts. The compiler inlines the kernels of these laws into the loop
(`granular.effects.effect`, `granular.compiled.hook_calls`); inactive effects cost nothing. If the cell is
mounted on a structure (a host), `bodies` also computes the motion of all its bodies. `state` checks the
energy of every record. `granular.run.run_directory_writer` stores the data with which a resumed run gives
the same bits as an uninterrupted one. `run_errors` makes the error messages. Kernels are declared with
`granular.compiled`.
"""
