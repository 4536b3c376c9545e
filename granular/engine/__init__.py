"""The engine: one compiled loop, specialised to the effects that a scene names.

This page says what its words mean; read it before the code. All numbers in here are in natural
units (`granular.schema.natural_units`): lengths in diameters D of the first species, times in tau.

A protocol is a row of stages, and the loop advances one stage at a time::

    stage    |==========================================================...
    frames   F                               F                          ...
    records  R               R               R               R          ...
    ticks    |-------|-------|-------|-------|-------|-------|-------|--...

and one of its ticks, here of twelve steps and with a far field that acts at most every eight::

    steps    | 1 | 2 | 3 | 4 | 5 | 6 | 7 | 8 | 9 | 10| 11| 12| look
    far      <-----------------------><---------------------->

step
    The least advance: the kicks and drifts of a method, one after another. Verlet's method is
    half a kick (velocities, positions stand still), a drift (positions, velocities stand still),
    the forces at the new positions, and the other half of the kick (`time_step`, `bodies`,
    `forces`).
tick
    Some steps and a *look* at the bed after the last of them: the forces of that step are computed
    in a *measuring pass*, which sums the energies, the stiffness and the least distance as well.
    Its result is a row of `columns`. Ticks of a stage are equally long (to a step, where the
    user gives the step); how many steps one has may change (`tick_loop`).
record, frame
    Every so many ticks the row is kept as a record, and, less often, positions, velocities and
    forces of all grains as a frame.
schedule
    How a stage is cut: the length of a tick and of a step, ticks from record to record and from
    frame to frame. The automatic step resolves the stiffest mode that the bed can meet; when a
    look finds one that is twice as stiff, the ticks that follow have more steps (`step_size`).
plan
    What all steps of a run have in common: the method's table of kicks and drifts, or its
    Butcher tableau, and how often the far field acts (`time_step`).
window
    Which ticks one call of the loop is to make. A call takes about a tenth of a second, ends at
    the next frame, and hands its records to Python, which keeps the ledger, writes checkpoints
    and answers Ctrl-C (`run`).
watch
    What ends a call before its window does: a grain where none can be, rest, a force on the
    piston that the stage was to reach, a step that has grown too long, a grain that has left.
far field
    Where pairs are summed with a mesh, the part of the force that varies slowly acts in impulses
    (`forces`): one kick opens an interval of at most ``far_every`` steps (``<``), one closes it
    (``>``), each with the field of that moment over half the interval. Intervals divide a tick, so
    that a look sees whole ones. The field at the stage's beginning is *held*: it acts in every
    step, like any other force, and the impulses give what the field differs from it by. (Where the
    scene dissipates, the present field is held anew every so many ticks.) Where dry friction must
    see the whole force together, and with methods other than Verlet's, the far field is computed in
    every step and there are no impulses.

A run changes a `State` of plain arrays, and reads `Constants`
(`granular.kernel_data`). In these stands, for every effect that acts, a law whose kernels the
compiler writes into the loop (`granular.effects.effect`, `granular.compiled.hook_calls`); of what
does not act nothing is there. A host that carries the cell moves all the others (`bodies`).
`state` checks the energy of every record, `granular.run.run_directory_writer` keeps what a resumed
run needs for the same bits, `run_errors` puts what went wrong into words. Kernels are declared with
`granular.compiled`.
"""
