"""State, input and noise estimation by DEM beside other observers: experiments of the papers that followed the paper.

F. Bos, A. Anil Meera, D. Benders and M. Wisse, "Free Energy Principle for State and Input Estimation of a Quadcopter
Flying in Wind", ICRA 2022 (arXiv:2109.12052), flew an AR.Drone 2.0 with and without a blower. Their settings are those
of the MATLAB scripts that they publish with the flights (github.com/FreddyBos97/DEM_Drone_in_wind).
"""
