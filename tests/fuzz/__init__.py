"""Every reader against hostile files: valid examples made by code, mutated, read, and the outcome judged.

Allowed outcomes are a sane result or a documented error, within 1 s of CPU time and 512 MB; everything else is a fault,
whose input is kept. What is where: `seeds` makes the examples, `mutate` changes them, `targets` lists the readers with
their checks, `outcome` judges one input, `worker` reads many in a process of its own, `campaign` watches the workers.

    make fuzz MINUTES=30                                  all readers, two processes, a fresh seed that is printed
    python -m tests.fuzz --minutes 5 --only mcap,png      some readers
    python -m tests.fuzz --minutes 5 --seed 7             the same inputs again
    python -m tests.fuzz --replay fuzz_faults/png-slow-0   one kept input once more, with its traceback

An input is kept as a folder: ``fault.json`` says what went wrong, ``case/`` holds the files, as they were read.
"""
