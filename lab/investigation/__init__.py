"""`lab investigate`: a diagnosis that runs the experiments it asks for. The loop itself is `diagnosis.investigate`.

Where things are
    command     the rig as the place where experiments are done; what a person reads while it goes on, and what is kept
    power       `lab power`: what a plan can tell, before it is measured
"""
