"""The figures of the chapter, drawn from simulated or real data: matplotlib Figure objects, no pyplot."""
