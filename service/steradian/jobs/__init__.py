"""Who does what when: jobs, their queue, the workers and what each kind of job does.

Nothing is imported here: the queue's engine takes seconds to load and only those who need it pay.
"""
