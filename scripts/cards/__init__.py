"""Cards of the shipped learned policies: DLCC of every training seed, intervals, and the training
itself.

Each policy is trained with several seeds. Their DLCCs are summarised by the interquartile mean and
a stratified bootstrap interval, as in rliable (Agarwal et al., *Deep Reinforcement Learning at the
Edge of the Statistical Precipice*, 2021). The shipped seed is the one with the median payload.
Making a card needs torch; reading and rendering one does not.
"""
