"""The sheet as a process makes it: parameters of the process, the surface it leaves, light through it.

Limits of processes are in `design/process_profiles.py`; parts measured by an instrument in `measuring`.
"""
